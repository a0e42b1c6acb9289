-- Title: Runs available to each comparison: runs of both sides, worlds that both met, pairs
-- Paper: sec:evaluation:significance
-- Grain: one row per comparison and configuration for which the ledger holds a run of either side
-- Key: comparison, configuration
-- Units: first_count, second_count runs; shared_worlds combinations of seed, scenario, fleet size and run that both
--   sides met; pair_count pairs that met the same world, left_out pairs with the same combination that did not; seeds,
--   fleet_sizes and scenarios of a side as lists
-- NULL: the lists of a side without runs
-- Example: fsar-ledger query statistics/comparable_runs LEDGER
WITH sides AS (
    SELECT
        comparison, configuration,
        'first' AS side,
        first_architecture AS architecture,
        first_configuration AS its_configuration
    FROM comparisons
    UNION ALL
    SELECT
        comparison, configuration,
        'second' AS side,
        second_architecture AS architecture,
        second_configuration AS its_configuration
    FROM comparisons
),

met AS (
    SELECT
        sides.comparison, sides.configuration, runs.fleet_size, runs.seed, runs.scenario, runs.run,
        count(*) FILTER (WHERE sides.side = 'first') AS first_runs,
        count(*) FILTER (WHERE sides.side = 'second') AS second_runs
    FROM sides
    INNER JOIN compared_runs AS runs
        ON sides.architecture = runs.architecture AND sides.its_configuration = runs.configuration
    GROUP BY ALL
),

worlds AS (
    SELECT
        comparison, configuration,
        sum(first_runs)::BIGINT AS first_count,
        sum(second_runs)::BIGINT AS second_count,
        count(*) FILTER (WHERE first_runs > 0 AND second_runs > 0) AS shared_worlds,
        list_sort(list(DISTINCT seed) FILTER (WHERE first_runs > 0)) AS first_seeds,
        list_sort(list(DISTINCT seed) FILTER (WHERE second_runs > 0)) AS second_seeds,
        list_sort(list(DISTINCT fleet_size) FILTER (WHERE first_runs > 0)) AS first_fleet_sizes,
        list_sort(list(DISTINCT fleet_size) FILTER (WHERE second_runs > 0)) AS second_fleet_sizes,
        list_sort(list(DISTINCT scenario) FILTER (WHERE first_runs > 0)) AS first_scenarios,
        list_sort(list(DISTINCT scenario) FILTER (WHERE second_runs > 0)) AS second_scenarios
    FROM met
    GROUP BY comparison, configuration
),

paired AS (
    SELECT
        comparison, configuration,
        count(*) FILTER (WHERE differs IS NULL) AS pair_count,
        count(*) FILTER (WHERE differs IS NOT NULL) AS left_out
    FROM run_pairs
    GROUP BY comparison, configuration
)

SELECT
    comparisons.comparison, comparisons.family, comparisons.configuration, comparisons.first_architecture,
    comparisons.first_configuration, comparisons.second_architecture, comparisons.second_configuration,
    worlds.first_count, worlds.second_count, worlds.shared_worlds, worlds.first_seeds, worlds.second_seeds,
    worlds.first_fleet_sizes, worlds.second_fleet_sizes, worlds.first_scenarios, worlds.second_scenarios,
    coalesce(paired.pair_count, 0) AS pair_count,
    coalesce(paired.left_out, 0) AS left_out
FROM comparisons
INNER JOIN worlds ON comparisons.comparison = worlds.comparison AND comparisons.configuration = worlds.configuration
LEFT JOIN paired ON comparisons.comparison = paired.comparison AND comparisons.configuration = paired.configuration
