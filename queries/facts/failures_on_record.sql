-- Title: Failures that any record mentions, even if their occurrence is not recorded
-- Paper: sec:model:recovery
-- Grain: one row per run, action and failure number that a record of recovery names
-- Key: run_id, action_id, failure
-- Units: detected_us, resolved_us microseconds of run time; seq the first record
-- NULL: robot where the records name none; detected_us when its occurrence is not on record, as for a failure before
--   the record began; resolved_us, resolved_level when never resolved
-- Example: fsar-ledger query facts/failures_on_record LEDGER
SELECT
    run_id, action_id, failure,
    min(seq) AS seq,
    arg_min(robot, seq) AS robot,
    min(time_us) FILTER (type = 'ExecutionFailed.v1') AS detected_us,
    min(time_us) FILTER (type = 'FailureResolved.v1') AS resolved_us,
    arg_min(level, seq) FILTER (type = 'FailureResolved.v1') AS resolved_level
FROM recovery_records
WHERE action_id IS NOT NULL AND failure IS NOT NULL
GROUP BY run_id, action_id, failure
