-- Title: Differences between two architectures, or configurations, that met the same world
-- Paper: sec:evaluation:significance
-- Grain: one row per test (paired_tests) and pair of runs that met the same world (run_pairs)
-- Key: test_id, pair
-- Units: first_value, second_value, difference (first minus second) in the metric's unit; difference_ppb billionths of
--   it, an integer, so that differences that are equal except for the last bits of a float tie in ranks; pair a number
--   of the pair, in the order of the names of its runs
-- NULL: never; pairs with a value that is undefined on the test's basis are left out
-- Example: fsar-ledger query statistics/paired_differences LEDGER
-- Stored: every test reads it
WITH pairs AS (
    SELECT
        comparison, family, seed, scenario, run, first_run_id, second_run_id,
        row_number() OVER (ORDER BY first_run_id, second_run_id) AS pair
    FROM run_pairs
    WHERE differs IS NULL
),

measured AS (
    SELECT
        tests.test_id, pairs.pair, pairs.seed, pairs.scenario, pairs.run,
        if(tests.basis = 'defined', firsts.value, firsts.published_convention_value) AS first_value,
        if(tests.basis = 'defined', seconds.value, seconds.published_convention_value) AS second_value
    FROM pairs
    INNER JOIN run_metrics AS firsts ON pairs.first_run_id = firsts.run_id
    INNER JOIN run_metrics AS seconds ON pairs.second_run_id = seconds.run_id AND firsts.metric = seconds.metric
    INNER JOIN paired_tests AS tests
        ON
            pairs.comparison = tests.comparison AND pairs.family = tests.family
            AND firsts.setting = tests.setting AND firsts.metric = tests.metric
            AND (tests.pools_seeds OR pairs.seed IS NOT DISTINCT FROM tests.seed)
)

SELECT
    test_id, pair, seed, scenario, run, first_value, second_value,
    first_value - second_value AS difference,
    round((first_value - second_value) * 1e9)::BIGINT AS difference_ppb
FROM measured
WHERE first_value IS NOT NULL AND second_value IS NOT NULL
