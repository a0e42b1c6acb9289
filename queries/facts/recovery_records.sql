-- Title: Records of the recovery from failures, and the level of each
-- Paper: eq:recovery
-- Grain: one row per event of the concern recovery, and per call or answer of a supervisor for recovery
-- Key: run_id, seq
-- Units: time_us, deadline_us microseconds of run time; number, failure count from 1
-- NULL: failure for a call or an answer, which name none; level where there is none; anything else that the record does
--   not name
-- Example: fsar-ledger query facts/recovery_records LEDGER
SELECT
    run_id, seq, time_us, type,
    coalesce(failed_action, action_id) AS action_id,
    failure, robot, helper,
    NULL AS supervisor,
    decided_by,
    CASE type WHEN 'ReassignmentDecided.v1' THEN 'fleet' WHEN 'AttemptRolledBack.v1' THEN 'local' ELSE level END
        AS level,
    to_level, number, deadline_us, checkpoint, reason, undone
FROM recovery_events
UNION ALL
SELECT
    run_id, seq, time_us, type, action_id,
    NULL AS failure,
    NULL AS robot,
    NULL AS helper,
    if(type = 'SupervisorCalled.v1', supervisor, NULL) AS supervisor,
    if(type = 'SupervisorResponded.v1', decided_by, NULL) AS decided_by,
    'human' AS level,
    NULL AS to_level,
    NULL AS number,
    NULL AS deadline_us,
    NULL AS checkpoint,
    NULL AS reason,
    NULL AS undone
FROM supervision_events
WHERE type IN ('SupervisorCalled.v1', 'SupervisorResponded.v1') AND purpose = 'recovery'
