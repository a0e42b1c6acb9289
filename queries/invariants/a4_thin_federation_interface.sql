-- Title: A4 broken: a decision about execution is taken by another principal than the robot that executes
-- Paper: sec:architecture:invariants (A4), eq:federation
-- Grain: one row per acceptance, admission, own step, routine, hold, replan, local recovery or assistance that the
--   robot did not decide itself
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id for a routine, and where the record does not name it
-- Example: fsar-ledger query invariants/a4_thin_federation_interface LEDGER
WITH decided AS (
    SELECT
        run_id, seq, time_us, type, action_id, decided_by,
        CASE
            WHEN type = 'AssistanceAdmitted.v1' THEN helper
            WHEN type IN ('RoutinePerformed.v1', 'RoutineWithheld.v1', 'ExecutionHeld.v1') THEN robot
            ELSE executed_by
        END AS executor
    FROM event_principals
    WHERE
        type IN (
            'RequestAdmitted.v1', 'RequestAccepted.v1', 'OwnStepDecided.v1', 'RoutinePerformed.v1',
            'RoutineWithheld.v1', 'ReplanOrdered.v1', 'AssistanceAdmitted.v1'
        )
        -- Waiting without a denial is no decision; its path is empty.
        OR (type = 'ExecutionHeld.v1' AND len(path) > 0)
    UNION ALL
    SELECT run_id, seq, time_us, 'RecoveryAttempted.v1' AS type, action_id, decided_by, robot AS executor
    FROM recovery_attempted
    WHERE level = 'local'
)

SELECT
    run_id, seq, time_us, type, action_id,
    coalesce(decided_by, 'nobody on record')
    || ' decides what '
    || coalesce(executor, 'an executor that is not on record')
    || ' executes' AS found
FROM decided
WHERE decided_by IS DISTINCT FROM executor OR NOT coalesce(starts_with(decided_by, 'robot/'), FALSE)
