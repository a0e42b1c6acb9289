-- Title: Plans: the runs of an experiment, recorded before the first of them
-- Paper: sec:evaluation:setup
-- Grain: one row per plan
-- Key: plan
-- Units: fleet_size robots; run_count runs for each architecture, configuration and scenario, numbered from first_run;
--   planned_count runs in all; parameters_sha256 the digest of all constants of world and structure
-- NULL: never
-- Example: fsar-ledger query staging/plans LEDGER
-- Stored: every answer reports whether all planned runs are there
SELECT
    run_id AS plan,
    seed, fleet_size,
    list_sort(list_distinct(architectures)) AS architectures,
    list_sort(list_distinct(configurations)) AS configurations,
    list_sort(list_distinct(scenarios)) AS scenarios,
    run_count, model_version,
    coalesce(first_run, 0) AS first_run,
    sha256(parameters) AS parameters_sha256,
    greatest(run_count, 0)::HUGEINT
    * len(list_distinct(architectures))
    * len(list_distinct(configurations))
    * len(list_distinct(scenarios)) AS planned_count
FROM experiment_planned
