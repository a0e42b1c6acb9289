-- Title: Runs with a known start
-- Paper: sec:evaluation:simulator
-- Grain: one row per run with an epoch
-- Key: run_id
-- Units: epoch the time in UTC of run time 0
-- NULL: never
-- Example: fsar-ledger query staging/run_epochs LEDGER
SELECT run_id, epoch::TIMESTAMP AS epoch
FROM run_started
WHERE try_cast(epoch AS TIMESTAMP) IS NOT NULL
