-- Title: Runs that no plan names
-- Paper: sec:evaluation:setup
-- Grain: one row per run that no plan names
-- Key: run_id
-- Units: fleet_size robots
-- NULL: dimensions that a run lacks, such as one that was not simulated
-- Example: fsar-ledger query audit/unplanned_runs LEDGER
--   answers one row for each live run, and for each run from before plans were on record
-- Live runs are never planned, and ledgers from before plans were recorded have none. Nothing in a ledger shows whether
-- such runs are complete.
SELECT
    runs.run_id, runs.kind, runs.seed, runs.fleet_size, runs.architecture, runs.configuration, runs.scenario, runs.run,
    runs.model_version, runs.parameters_sha256
FROM runs
LEFT JOIN planned_runs ON runs.run_id = planned_runs.run_id
WHERE planned_runs.run_id IS NULL
