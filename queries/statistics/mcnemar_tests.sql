-- Title: Exact McNemar tests of the metrics that are 0 or 1 per run
-- Paper: sec:evaluation:significance
-- Grain: one row per test (as in paired_t_tests) with at least one pair
-- Key: test
-- Units: mcnemar_first_only, mcnemar_second_only pairs in which only that architecture has a 1
-- NULL: never; mcnemar_p is 1 when no pair differs
-- Example: fsar-ledger query statistics/mcnemar_tests LEDGER
WITH discordant AS (
    SELECT
        tests.test,
        count(*) FILTER (WHERE differences.difference_ppb > 0)::BIGINT AS mcnemar_first_only,
        count(*) FILTER (WHERE differences.difference_ppb < 0)::BIGINT AS mcnemar_second_only
    FROM paired_tests AS tests
    INNER JOIN metric_definitions AS definitions ON tests.metric = definitions.metric
    INNER JOIN paired_differences AS differences ON tests.test_id = differences.test_id
    WHERE definitions.scale = 'yes-no'
    GROUP BY tests.test
)

SELECT
    test, mcnemar_first_only, mcnemar_second_only,
    binomial_half_sf2(
        least(mcnemar_first_only, mcnemar_second_only)::DOUBLE,
        (mcnemar_first_only + mcnemar_second_only)::DOUBLE
    ) AS mcnemar_p
FROM discordant
