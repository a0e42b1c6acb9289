-- Title: Differences between two architectures that met the same world
-- Paper: sec:evaluation:significance
-- Grain: one row per comparison, metric, pair of runs (same configuration, seed, scenario, fleet size, run, model and parameters) and basis:
--        published counts a metric that is undefined for a run as the paper does, defined leaves such pairs out
-- Units: first_value, second_value, difference (first minus second) in the metric's unit; difference_ppb billionths of it, an integer
--        so that differences which are equal but for the last bits of a float tie in ranks
-- NULL: never (test names basis, configuration, fleet size, metric and comparison in one text); pairs with an undefined value are left out
-- Example: fsar-ledger query statistics/paired_differences LEDGER
-- Stored: every test reads it
WITH measured AS (
    SELECT
        *,
        'published' AS basis,
        published_convention_value AS tested_value
    FROM run_metrics
    UNION ALL
    SELECT
        *,
        'defined' AS basis,
        value AS tested_value
    FROM run_metrics
)

SELECT
    concat_ws('/', first_runs.basis, first_runs.configuration, first_runs.fleet_size, first_runs.metric, comparisons.comparison) AS test,
    first_runs.basis,
    first_runs.configuration,
    first_runs.fleet_size,
    first_runs.position,
    first_runs.metric,
    comparisons.comparison,
    first_runs.seed,
    first_runs.scenario,
    first_runs.run,
    first_runs.run_id AS first_run_id,
    second_runs.run_id AS second_run_id,
    first_runs.tested_value AS first_value,
    second_runs.tested_value AS second_value,
    first_runs.tested_value - second_runs.tested_value AS difference,
    round((first_runs.tested_value - second_runs.tested_value) * 1e9)::BIGINT AS difference_ppb
FROM comparisons
INNER JOIN measured AS first_runs ON comparisons.first_architecture = first_runs.architecture
INNER JOIN measured AS second_runs
    ON
        comparisons.second_architecture = second_runs.architecture
        AND first_runs.basis = second_runs.basis
        AND first_runs.metric = second_runs.metric
        AND first_runs.configuration = second_runs.configuration
        AND first_runs.fleet_size = second_runs.fleet_size
        AND first_runs.seed = second_runs.seed
        AND first_runs.scenario = second_runs.scenario
        AND first_runs.run = second_runs.run
        AND first_runs.model_version = second_runs.model_version
        AND first_runs.parameters_sha256 = second_runs.parameters_sha256
WHERE first_runs.tested_value IS NOT NULL AND second_runs.tested_value IS NOT NULL
