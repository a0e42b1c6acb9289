-- Title: The steps of each failure's recovery, and the result of each
-- Paper: eq:recovery, fig:wf3
-- Grain: one row per failure and attempt, rollback, question, reassignment, escalation or resolution
-- Key: run_id, action_id, failure, seq
-- Units: detected_us, time_us, until_us microseconds of run time; until_us is when the next step was taken
-- NULL: detected_us when the failure itself is not on record; decided_by, helper when the record names none; result
--   when there was none or none is recorded; until_us of the last step; to_level, deadline_us, achieved when none
-- Example: fsar-ledger query facts/recovery_steps LEDGER
WITH records AS (
    SELECT
        run_id, seq, time_us, type, action_id, failure, helper, supervisor, decided_by, level, to_level, number,
        deadline_us, checkpoint, reason, undone
    FROM recovery_records
    UNION ALL BY NAME
    SELECT run_id, seq, time_us, 'RegistryQueried.v1' AS type, action_id, 'peer' AS level, capability, candidates
    FROM registry_queried
),

steps AS (
    SELECT
        failures.run_id, failures.action_id, failures.failure, failures.detected_us, failures.resolved_level,
        records.seq, records.time_us, records.type, records.helper, records.supervisor, records.decided_by,
        records.level, records.to_level, records.number, records.deadline_us, records.checkpoint, records.reason,
        records.undone, records.capability, records.candidates,
        lead(records.time_us) OVER in_order AS until_us,
        lead(records.type) OVER in_order AS next_type
    FROM records
    ASOF INNER JOIN failures_on_record AS latest
        ON records.run_id = latest.run_id AND records.action_id = latest.action_id AND records.seq >= latest.seq
    -- A query to the registry, and a call, name no failure: they belong to the last one, until it is resolved.
    INNER JOIN failures_on_record AS failures
        ON
            records.run_id = failures.run_id AND records.action_id = failures.action_id
            AND failures.failure = coalesce(records.failure, latest.failure)
    WHERE
        records.type IN (
            'RecoveryAttempted.v1', 'AttemptRolledBack.v1', 'RecoveryEscalated.v1', 'AssistanceRequested.v1',
            'ReassignmentDecided.v1', 'FailureResolved.v1'
        )
        OR (
            records.type IN ('RegistryQueried.v1', 'SupervisorCalled.v1')
            AND records.time_us <= coalesce(failures.resolved_us, records.time_us)
        )
    WINDOW in_order AS (PARTITION BY failures.run_id, failures.action_id, failures.failure ORDER BY records.seq)
)

SELECT
    steps.run_id, steps.action_id, steps.failure, steps.detected_us, steps.seq, steps.type, steps.time_us,
    steps.until_us, steps.decided_by, steps.level, steps.to_level, steps.deadline_us, steps.helper,
    CASE steps.type
        WHEN 'RecoveryAttempted.v1' THEN concat('attempt ', steps.number)
        WHEN 'AttemptRolledBack.v1' THEN 'has rolled back ' || array_to_string(steps.undone, ', ')
        WHEN 'AssistanceRequested.v1' THEN concat('asks ', steps.helper, ' for help')
        WHEN 'RegistryQueried.v1' THEN 'asks the registry for ' || steps.capability
        WHEN 'ReassignmentDecided.v1' THEN 'evaluates reassignment'
        WHEN 'SupervisorCalled.v1' THEN 'asks ' || steps.supervisor
        WHEN 'RecoveryEscalated.v1' THEN concat('leaves ', steps.level, ' for ', steps.to_level)
        ELSE 'resolved'
    END AS what,
    CASE
        WHEN steps.type = 'RecoveryEscalated.v1' THEN steps.reason
        WHEN steps.type = 'RegistryQueried.v1'
            THEN if(len(steps.candidates) = 0, 'no peer', array_to_string(steps.candidates, ', '))
        WHEN steps.type = 'ReassignmentDecided.v1' AND steps.helper IS NULL
            THEN concat_ws(': ', 'infeasible', steps.reason)
        WHEN steps.type = 'ReassignmentDecided.v1' THEN 'to ' || concat_ws(' from ', steps.helper, steps.checkpoint)
        WHEN steps.type = 'SupervisorCalled.v1' THEN if(steps.resolved_level = 'human', 'resolved', NULL)
        WHEN answers.answer IS NOT NULL OR steps.next_type IS NULL THEN answers.answer
        WHEN steps.type = 'RecoveryAttempted.v1' AND steps.next_type <> 'FailureResolved.v1' THEN 'failure'
        WHEN steps.type = 'AssistanceRequested.v1' AND steps.next_type <> 'FailureResolved.v1' THEN 'no help'
        WHEN steps.type = 'RecoveryAttempted.v1' AND steps.level = steps.resolved_level THEN 'success'
        WHEN steps.type = 'AssistanceRequested.v1' AND steps.level = steps.resolved_level THEN 'helped'
    END AS result,
    answers.achieved
FROM steps
ASOF LEFT JOIN recovery_answers AS answers
    ON
        steps.run_id = answers.run_id AND steps.action_id = answers.action_id AND steps.failure = answers.failure
        AND steps.type = answers.question AND coalesce(steps.number, 0) = coalesce(answers.number, 0)
        AND steps.seq < answers.seq AND coalesce(steps.helper, '') = coalesce(answers.helper, '')
