-- Title: p values of the paired t-tests, adjusted by Holm over their family
-- Paper: tab:significance
-- Grain: one row per test (basis, configuration, fleet size, metric, comparison) whose p is defined
-- Units: p_holm, the smallest family-wise error rate at which the test rejects; the family are the tests of one basis, configuration and fleet size (24)
-- NULL: never
-- Example: fsar-ledger query statistics/holm_adjustments LEDGER
WITH ranked AS (
    SELECT
        test,
        basis,
        configuration,
        fleet_size,
        p,
        row_number() OVER (PARTITION BY basis, configuration, fleet_size ORDER BY p, test) AS step,
        count(*) OVER (PARTITION BY basis, configuration, fleet_size) AS tests
    FROM paired_t_tests
    WHERE p IS NOT NULL
)

SELECT
    test,
    least(1, max((tests - step + 1) * p) OVER (PARTITION BY basis, configuration, fleet_size ORDER BY step)) AS p_holm
FROM ranked
