-- Title: Wilcoxon signed-rank tests
-- Paper: sec:evaluation:significance
-- Grain: one row per test (as in paired_t_tests) with at least one pair
-- Key: test
-- Units: n pairs that differ (zeros are dropped); w the smaller rank sum; z of the rank sum of positive differences,
--   variance corrected for ties, no continuity correction. Ranks are average ranks of the absolute differences in
--   billionths of the metric's unit
-- NULL: w when no pair differs; z, p when fewer than 6 do: too few for the normal approximation, and no p below 0.05 is
--   possible
-- Example: fsar-ledger query statistics/wilcoxon_tests LEDGER
WITH ranked AS (
    SELECT
        test_id, difference_ppb,
        count(*) OVER ties AS tied,
        -- Twice the average rank, an integer, so that its sums are exact.
        2 * rank() OVER (PARTITION BY test_id ORDER BY abs(difference_ppb)) + count(*) OVER ties - 1 AS rank_x2
    FROM paired_differences
    WHERE difference_ppb <> 0
    WINDOW ties AS (PARTITION BY test_id, abs(difference_ppb))
),

sums AS (
    SELECT
        test_id,
        count(*) AS n,
        coalesce(sum(rank_x2) FILTER (WHERE difference_ppb > 0), 0)::BIGINT / 2 AS positive,
        coalesce(sum(rank_x2) FILTER (WHERE difference_ppb < 0), 0)::BIGINT / 2 AS negative,
        sum(tied * tied - 1)::DOUBLE AS tie_term
    FROM ranked
    GROUP BY test_id
),

scores AS (
    SELECT
        test_id, n, positive, negative,
        CASE
            WHEN n >= 6 THEN (positive - n * (n + 1) / 4) / sqrt(n::DOUBLE * (n + 1) * (2 * n + 1) / 24 - tie_term / 48)
        END AS z
    FROM sums
)

SELECT
    tests.test,
    coalesce(scores.n, 0) AS wilcoxon_n,
    least(scores.positive, scores.negative) AS wilcoxon_w,
    scores.z AS wilcoxon_z,
    norm_sf2(scores.z) AS wilcoxon_p
FROM paired_tests AS tests
LEFT JOIN scores ON tests.test_id = scores.test_id
