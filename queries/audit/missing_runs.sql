-- Title: Missing planned runs, each counted once, however many plans name it
-- Paper: sec:evaluation:setup
-- Grain: one row per seed, fleet size, model version, constants, architecture, configuration and scenario of a plan
--   that lacks runs
-- Key: seed, fleet_size, model_version, parameters_sha256, architecture, configuration, scenario
-- Units: planned_count, there_count, missing_count runs; parameters_sha256 the digest of all constants
-- NULL: never
-- Example: fsar-ledger query audit/missing_runs LEDGER
--   answers no rows where all that was planned is there
-- Of several overlapping plans each run number counts once, and a plan within a larger one adds nothing. A plan of more
-- than 10,000 combinations of names, which no experiment has, is left out.
WITH lacking AS (
    SELECT *
    FROM experiments
    WHERE
        missing_count > 0 AND larger_plans = 0
        AND len(architectures)::HUGEINT * len(configurations) * len(scenarios) <= 10000
),

ranges AS (
    SELECT
        lacking.seed, lacking.fleet_size, lacking.model_version, lacking.parameters_sha256, architectures.architecture,
        configurations.configuration, scenarios.scenario, lacking.first_run,
        max(lacking.first_run::HUGEINT + lacking.run_count) AS end_run
    FROM lacking
    CROSS JOIN unnest(lacking.architectures) AS architectures (architecture)
    CROSS JOIN unnest(lacking.configurations) AS configurations (configuration)
    CROSS JOIN unnest(lacking.scenarios) AS scenarios (scenario)
    GROUP BY ALL
),

own AS (
    SELECT
        seed, fleet_size, model_version, parameters_sha256, architecture, configuration, scenario, first_run, end_run,
        max(end_run) OVER (
            PARTITION BY seed, fleet_size, model_version, parameters_sha256, architecture, configuration, scenario
            ORDER BY first_run ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
        ) AS end_before
    FROM ranges
),

planned AS (
    SELECT
        seed, fleet_size, model_version, parameters_sha256, architecture, configuration, scenario,
        sum(greatest(0, end_run - greatest(first_run, coalesce(end_before, first_run))))::HUGEINT AS planned_count
    FROM own
    GROUP BY ALL
),

there AS (
    SELECT
        lacking.seed, lacking.fleet_size, lacking.model_version, lacking.parameters_sha256, runs.architecture,
        runs.configuration, runs.scenario,
        count(DISTINCT runs.run) AS there_count
    FROM lacking
    INNER JOIN planned_runs AS runs ON lacking.plan = runs.plan
    GROUP BY ALL
)

SELECT
    planned.seed, planned.fleet_size, planned.model_version, planned.parameters_sha256, planned.architecture,
    planned.configuration, planned.scenario, planned.planned_count,
    coalesce(there.there_count, 0) AS there_count,
    planned.planned_count - coalesce(there.there_count, 0) AS missing_count
FROM planned
LEFT JOIN there
    ON
        planned.seed = there.seed AND planned.fleet_size = there.fleet_size
        AND planned.model_version = there.model_version AND planned.parameters_sha256 = there.parameters_sha256
        AND planned.architecture = there.architecture AND planned.configuration = there.configuration
        AND planned.scenario = there.scenario
WHERE planned.planned_count > coalesce(there.there_count, 0)
