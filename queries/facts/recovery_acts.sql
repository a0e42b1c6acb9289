-- Title: Acts of recovery for each failure: at which level, and with which budget
-- Paper: eq:recovery, app:foundations (Paper 3)
-- Grain: one row per failure and attempt, question for help or its admission, reassignment decision, call or answer for
--   recovery, escalation or resolution; for an action that was under way when the record began, only from its first
--   recorded failure on
-- Key: run_id, seq
-- Units: time_us, deadline_us microseconds of run time; t_max_us microseconds; n_max uses; rank 1 local to 4 human
-- NULL: failure, robot before any failure of the action; level, rank where the record names none; to_level, to_rank
--   unless an escalation; t_max_us, n_max as in facts/recovery_allowances; helper, deadline_us, reason where the record
--   gives none
-- Example: fsar-ledger query facts/recovery_acts LEDGER
-- Stored: I4 and the cases that the audit checked both read it
WITH ranks (level, rank) AS (
    VALUES
    ('local', 1),
    ('peer', 2),
    ('fleet', 3),
    ('human', 4)
),

records AS (
    SELECT
        run_id, seq, time_us, type, action_id, helper, number, deadline_us, reason, to_level, level,
        -- A call and its answer name no failure: they belong to the last one of the action.
        coalesce(failure, last_value(CASE WHEN type = 'ExecutionFailed.v1' THEN failure END IGNORE NULLS) OVER so_far)
            AS failure,
        last_value(CASE WHEN type = 'ExecutionFailed.v1' THEN robot END IGNORE NULLS) OVER so_far AS robot
    FROM recovery_records
    ANTI JOIN actions_under_way AS earlier
        ON
            recovery_records.run_id = earlier.run_id AND recovery_records.action_id = earlier.action_id
            AND recovery_records.seq < coalesce(earlier.failed_seq, recovery_records.seq + 1)
    WHERE
        type IN (
            'ExecutionFailed.v1', 'RecoveryAttempted.v1', 'AssistanceRequested.v1', 'AssistanceAdmitted.v1',
            'ReassignmentDecided.v1', 'RecoveryEscalated.v1', 'FailureResolved.v1', 'SupervisorCalled.v1',
            'SupervisorResponded.v1'
        )
    WINDOW so_far AS (PARTITION BY run_id, action_id ORDER BY seq ROWS BETWEEN UNBOUNDED PRECEDING AND CURRENT ROW)
),

helped AS (
    SELECT DISTINCT run_id, action_id, failure, helper
    FROM assistance_ended
),

fruitless AS (
    SELECT DISTINCT run_id, action_id, failure, number
    FROM recovery_attempt_failed
)

SELECT
    records.run_id, records.seq, records.time_us, records.type, records.action_id, records.helper, records.deadline_us,
    records.reason, records.to_level, records.level, records.failure, records.robot, ranks.rank,
    targets.rank AS to_rank,
    allowed.t_max_us, allowed.n_max,
    records.type IN ('RecoveryAttempted.v1', 'AssistanceRequested.v1', 'SupervisorCalled.v1')
    OR (records.type = 'ReassignmentDecided.v1' AND records.helper IS NOT NULL) AS is_use,
    -- A failure can be resolved at the level by an attempt that did not fail, completed help, a takeover or a human.
    records.type = 'SupervisorResponded.v1'
    OR (records.type = 'RecoveryAttempted.v1' AND fruitless.run_id IS NULL)
    OR (records.type = 'AssistanceAdmitted.v1' AND helped.run_id IS NOT NULL)
    OR (records.type = 'ReassignmentDecided.v1' AND records.helper IS NOT NULL) AS is_remedy
FROM records
LEFT JOIN ranks ON records.level = ranks.level
LEFT JOIN ranks AS targets ON records.to_level = targets.level
LEFT JOIN fruitless
    ON
        records.run_id = fruitless.run_id AND records.action_id = fruitless.action_id
        AND records.failure = fruitless.failure AND records.number = fruitless.number
LEFT JOIN helped
    ON
        records.run_id = helped.run_id AND records.action_id = helped.action_id
        AND records.failure = helped.failure AND records.helper = helped.helper
ASOF LEFT JOIN recovery_allowances AS allowed
    ON
        records.run_id = allowed.run_id AND records.robot = allowed.robot AND records.level = allowed.level
        AND records.seq >= allowed.since_seq
