-- Title: Means, differences and their standard errors over the pairs of two sides
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of sides (side_comparisons), metric, seed or all seeds (pools_seeds), and scenario or all
--   scenarios
-- Key: first_side, second_side, pools_seeds, seed?, scenario?, metric
-- Units: means, mean_difference, error in the metric's unit; containment and latency are pooled: ratios over all pairs,
--   with a standard error by the jackknife over pairs; n pairs, differing_pairs those in which the runs differ, above
--   and below those in which the first side is higher, or lower
-- NULL: seed for all seeds; scenario for all scenarios; means of a side that counts nothing; sd, error where
--   contributions do not vary, and where a side counts only one pair
-- Example: fsar-ledger query statistics/side_moments LEDGER
WITH moments AS (
    -- Floats summed in a fixed order give the same bits on any number of threads.
    SELECT
        first_side, second_side, pools_seeds, seed, scenario, metric,
        count(*) AS n,
        count(*) FILTER (WHERE differs) AS differing_pairs,
        count(*) FILTER (WHERE direction > 0)::DOUBLE AS above,
        count(*) FILTER (WHERE direction < 0)::DOUBLE AS below,
        if(is_pooled, any_value(first_ratio), avg(first_value ORDER BY first_run_id, second_run_id)) AS first_mean,
        if(is_pooled, any_value(second_ratio), avg(second_value ORDER BY first_run_id, second_run_id)) AS second_mean,
        stddev_samp(contribution ORDER BY first_run_id, second_run_id) AS spread,
        count(contribution) = n AND max(contribution) - min(contribution) > 1e-9 AS varies
    FROM side_values
    GROUP BY first_side, second_side, pools_seeds, seed, scenario, metric, is_pooled
)

SELECT
    first_side, second_side, pools_seeds, seed, scenario, metric, n, differing_pairs, above, below, first_mean,
    second_mean,
    first_mean - second_mean AS mean_difference,
    CASE WHEN varies THEN spread END AS sd,
    CASE WHEN varies THEN spread / sqrt(n) END AS error
FROM moments
