-- Title: Runs and their dimensions
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Key: run_id
-- Units: fleet_size robots; run counts from 0 within seed and scenario; parameters_sha256 the digest of all constants
--   of the world and of structure
-- NULL: what the run does not have; source but of a foreign run
-- Example: fsar-ledger query staging/runs LEDGER
-- Stored: every metric reads it
SELECT
    run_id, kind, observes, seed, architecture, configuration, scenario, fleet_size, run, model_version,
    sha256(parameters) AS parameters_sha256,
    source
FROM run_started
