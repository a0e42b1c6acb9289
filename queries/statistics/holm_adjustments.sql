-- Title: p values of the paired t-tests, adjusted by Holm over their family
-- Paper: tab:significance
-- Grain: one row per test (as in paired_t_tests) whose p is defined
-- Key: test
-- Units: family_tests, how many tests the family has; p_holm, the smallest family-wise error rate at which the test
--   rejects; the family consists of the tests of one basis, setting, seed or all seeds, and all comparisons of
--   architectures (24 tests), or all ablations of one architecture (8 for each)
-- NULL: never
-- Example: fsar-ledger query statistics/holm_adjustments LEDGER
WITH ranked AS (
    SELECT
        test, holm_family, p,
        row_number() OVER (PARTITION BY holm_family ORDER BY p, test) AS step,
        count(*) OVER (PARTITION BY holm_family) AS tests
    FROM paired_t_tests
    WHERE p IS NOT NULL
)

SELECT
    test,
    tests AS family_tests,
    least(1, max((tests - step + 1) * p) OVER (PARTITION BY holm_family ORDER BY step)) AS p_holm
FROM ranked
