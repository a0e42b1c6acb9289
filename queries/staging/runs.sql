-- Title: Runs and their dimensions
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Key: run_id
-- Units: number the position in the ledger, from 1 (staging/run_numbers); fleet_size robots; run counts from 0 within
--   seed and scenario; parameters_sha256 the digest of all constants of the world and of structure; forked_from the run
--   that a fork repeats at first
-- NULL: dimensions that the run lacks; source of a run that is not foreign; forked_from of one that is no fork
-- Example: fsar-ledger query staging/runs LEDGER
-- Stored: every metric reads it
SELECT
    numbers.number, started.run_id, started.kind, started.observes, started.seed, started.architecture,
    started.configuration, started.scenario, started.fleet_size, started.run, started.model_version,
    sha256(started.parameters) AS parameters_sha256,
    started.source,
    started.forked_from_run AS forked_from
FROM run_started AS started
LEFT JOIN run_numbers AS numbers ON started.run_id = numbers.run_id
