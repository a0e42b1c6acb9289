-- Title: What recovery did about failures of which nobody recorded that they occurred, step by step
-- Paper: eq:recovery, fig:wf3
-- Grain: one row per step, as in facts/recovery_steps, of a failure without an ExecutionFailed event
-- Key: run_id, action_id, failure, seq
-- Units: time_us, until_us microseconds of run time; until_us is when the next step was taken
-- NULL: detected_us always; decided_by, helper, result where the record has none; until_us of the last step
-- Example: fsar-ledger query facts/steps_of_unseen_failures LEDGER
WITH answers AS (
    SELECT
        run_id, action_id, failure, number, helper,
        arg_min(
            if(type = 'AssistanceDeclined.v1', 'busy', if(type = 'AssistanceFailed.v1', 'no help: ' || cause, result)),
            seq
        ) AS answer,
        arg_min(nullif(array_to_string(achieved, ', '), ''), seq) AS achieved
    FROM recovery_events
    WHERE type IN ('RecoveryAttemptFailed.v1', 'AssistanceDeclined.v1', 'AssistanceFailed.v1')
    GROUP BY run_id, action_id, failure, number, helper
),

steps AS (
    SELECT
        failures.run_id, failures.action_id, failures.failure, records.seq, records.type, records.time_us,
        records.decided_by, records.level, records.to_level, records.deadline_us, records.helper, records.supervisor,
        records.number, records.checkpoint, records.reason, records.undone,
        lead(records.time_us) OVER in_order AS until_us,
        lead(records.type) OVER in_order AS next_type
    FROM failures_on_record AS failures
    INNER JOIN recovery_records AS records
        ON
            failures.run_id = records.run_id AND failures.action_id = records.action_id
            AND (
                failures.failure = records.failure
                -- A call names no failure: it is about the one that is not resolved yet.
                OR (
                    records.type = 'SupervisorCalled.v1' AND failures.seq < records.seq
                    AND records.time_us <= coalesce(failures.resolved_us, records.time_us)
                )
            )
    WHERE
        failures.detected_us IS NULL
        AND records.type IN (
            'RecoveryAttempted.v1', 'AttemptRolledBack.v1', 'RecoveryEscalated.v1', 'AssistanceRequested.v1',
            'ReassignmentDecided.v1', 'FailureResolved.v1', 'SupervisorCalled.v1'
        )
    WINDOW in_order AS (PARTITION BY failures.run_id, failures.action_id, failures.failure ORDER BY records.seq)
)

SELECT
    steps.run_id, steps.action_id, steps.failure,
    NULL::BIGINT AS detected_us,
    steps.seq, steps.type, steps.time_us, steps.until_us, steps.decided_by, steps.level, steps.to_level,
    steps.deadline_us, steps.helper,
    CASE steps.type
        WHEN 'RecoveryAttempted.v1' THEN concat('attempt ', steps.number)
        WHEN 'AttemptRolledBack.v1' THEN 'has rolled back ' || array_to_string(steps.undone, ', ')
        WHEN 'AssistanceRequested.v1' THEN concat('asks ', steps.helper, ' for help')
        WHEN 'ReassignmentDecided.v1' THEN 'evaluates reassignment'
        WHEN 'SupervisorCalled.v1' THEN 'asks ' || steps.supervisor
        WHEN 'RecoveryEscalated.v1' THEN concat('leaves ', steps.level, ' for ', steps.to_level)
        ELSE 'resolved'
    END AS what,
    CASE
        WHEN steps.type = 'RecoveryEscalated.v1' THEN steps.reason
        WHEN steps.type = 'ReassignmentDecided.v1' AND steps.helper IS NULL
            THEN concat_ws(': ', 'infeasible', steps.reason)
        WHEN steps.type = 'ReassignmentDecided.v1' THEN 'to ' || concat_ws(' from ', steps.helper, steps.checkpoint)
        WHEN answers.answer IS NOT NULL THEN answers.answer
        WHEN steps.type = 'RecoveryAttempted.v1' AND steps.next_type IS NOT NULL
            THEN if(steps.next_type = 'FailureResolved.v1', 'success', 'failure')
        WHEN steps.type = 'AssistanceRequested.v1' AND steps.next_type IS NOT NULL
            THEN if(steps.next_type = 'FailureResolved.v1', 'helped', 'no help')
    END AS result,
    answers.achieved
FROM steps
LEFT JOIN answers
    ON
        steps.run_id = answers.run_id AND steps.action_id = answers.action_id AND steps.failure = answers.failure
        AND steps.number IS NOT DISTINCT FROM answers.number AND steps.helper IS NOT DISTINCT FROM answers.helper
        AND steps.type IN ('RecoveryAttempted.v1', 'AssistanceRequested.v1')
