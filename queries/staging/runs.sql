-- Title: Runs and their dimensions
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Units: fleet_size robots; run counts from 0 within seed and scenario
-- NULL: never
-- Example: fsar-ledger query staging/runs LEDGER
-- Stored: every metric reads it
SELECT
    run_id,
    kind,
    seed,
    architecture,
    configuration,
    scenario,
    fleet_size,
    run,
    model_version
FROM run_started
