-- Title: The reduction in variance by pairing the runs of two sides, relative to independent runs
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of sides (side_comparisons), metric, seed or all seeds (pools_seeds), and scenario or all
--   scenarios
-- Key: first_side, second_side, pools_seeds, seed?, scenario?, metric
-- Units: gain, the variance of the difference of two independent runs divided by that of a pair; the same precision
--   would need that many times as many independent runs
-- NULL: seed for all seeds; scenario for all scenarios; gain where pairs do not vary, or where a contribution is not
--   defined
-- Example: fsar-ledger query statistics/side_gains LEDGER
SELECT
    first_side, second_side, pools_seeds, seed, scenario, metric,
    CASE
        WHEN max(contribution) - min(contribution) > 1e-9 AND count(contribution) = count(*)
            THEN
                (
                    var_samp(first_contribution ORDER BY first_run_id, second_run_id)
                    + var_samp(second_contribution ORDER BY first_run_id, second_run_id)
                ) / var_samp(contribution ORDER BY first_run_id, second_run_id)
    END AS gain
FROM side_values
GROUP BY first_side, second_side, pools_seeds, seed, scenario, metric
