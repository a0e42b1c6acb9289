-- Title: Tests of the numbers that the results table prints: containment and latency pooled over failures, as ratios
--   over all pairs
-- Paper: tab:significance
-- Grain: one row per comparison, configuration, setting (kind, source, model version, constants, fleet size), seed or
--   all seeds, and pooled metric
-- Key: test
-- Units: test as in paired_t_tests, without its basis; means, difference and interval in the metric's unit, n pairs, of
--   which differing_pairs have runs that differ, pooled_test, p as in side_differences; p_holm over the family_tests
--   tests of the same family (as in holm_adjustments, on the basis published), with these as the tests of pooled
--   metrics
-- NULL: as in side_differences
-- Example: fsar-ledger query statistics/pooled_tests LEDGER
WITH pooled AS (
    SELECT
        concat_ws(
            '/',
            comparisons.family,
            comparisons.comparison,
            comparisons.setting,
            coalesce(found.seed::VARCHAR, 'all'),
            found.metric
        ) AS test,
        concat_ws(
            '/',
            'published',
            comparisons.family,
            comparisons.setting,
            coalesce(found.seed::VARCHAR, 'all'),
            CASE WHEN NOT definitions.is_published THEN found.metric END
        ) AS holm_family,
        found.seed, found.metric, found.n, found.differing_pairs, found.first_mean, found.second_mean,
        found.mean_difference, found.p, found.ci_low, found.ci_high,
        found.test AS pooled_test
    FROM side_comparisons AS comparisons
    INNER JOIN side_differences AS found
        ON comparisons.first_side = found.first_side AND comparisons.second_side = found.second_side
    INNER JOIN metric_definitions AS definitions ON found.metric = definitions.metric
    WHERE definitions.is_pooled AND found.scenario IS NULL
),

family AS (
    SELECT holm_family, test, p
    FROM pooled
    WHERE p IS NOT NULL
    UNION ALL
    SELECT t_tests.holm_family, t_tests.test, t_tests.p
    FROM paired_t_tests AS t_tests
    INNER JOIN metric_definitions AS definitions ON t_tests.metric = definitions.metric
    WHERE t_tests.basis = 'published' AND NOT definitions.is_pooled AND t_tests.p IS NOT NULL
),

ranked AS (
    SELECT
        holm_family, test, p,
        row_number() OVER (PARTITION BY holm_family ORDER BY p, test) AS step,
        count(*) OVER (PARTITION BY holm_family) AS family_tests
    FROM family
),

adjusted AS (
    SELECT
        test, family_tests,
        least(1, max((family_tests - step + 1) * p) OVER (PARTITION BY holm_family ORDER BY step)) AS p_holm
    FROM ranked
)

SELECT
    pooled.test, pooled.seed, pooled.metric, pooled.n, pooled.differing_pairs, pooled.first_mean, pooled.second_mean,
    pooled.mean_difference, pooled.ci_low, pooled.ci_high, pooled.pooled_test, pooled.p, adjusted.p_holm,
    adjusted.family_tests
FROM pooled
LEFT JOIN adjusted ON pooled.test = adjusted.test
