-- Title: What recovery did about each failure, step by step, and what came of it
-- Paper: eq:recovery, fig:wf3
-- Grain: one row per failure and attempt, rollback, question, reassignment, escalation or resolution
-- Key: run_id, action_id, failure, seq
-- Units: detected_us, time_us, until_us microseconds of run time; until_us is when the next step was taken
-- NULL: decided_by when the record names none; result when none came or is recorded; until_us of the last step
-- Example: fsar-ledger query facts/recovery_steps LEDGER
WITH answers AS (
    -- What came of an attempt, or of a question for help, where the record says so.
    SELECT
        run_id, action_id, failure, number, helper,
        any_value(
            if(type = 'AssistanceDeclined.v1', 'busy', if(type = 'AssistanceFailed.v1', 'no help: ' || cause, result))
        ) AS answer,
        any_value(nullif(array_to_string(achieved, ', '), '')) AS achieved
    FROM recovery_events
    WHERE type IN ('RecoveryAttemptFailed.v1', 'AssistanceDeclined.v1', 'AssistanceFailed.v1')
    GROUP BY run_id, action_id, failure, number, helper
),

steps AS (
    SELECT
        run_id, seq, time_us, type, action_id, failure, helper, supervisor, decided_by, level, to_level, number,
        deadline_us, checkpoint, reason, undone
    FROM recovery_records
    UNION ALL BY NAME
    SELECT run_id, seq, time_us, 'RegistryQueried.v1' AS type, action_id, 'peer' AS level, capability, candidates
    FROM registry_queried
)

SELECT
    failures.run_id, failures.action_id, failures.failure, failures.detected_us, steps.seq, steps.type, steps.time_us,
    lead(steps.time_us) OVER in_order AS until_us,
    steps.decided_by, steps.level, steps.to_level, steps.deadline_us,
    CASE steps.type
        WHEN 'RecoveryAttempted.v1' THEN 'attempt ' || steps.number
        WHEN 'AttemptRolledBack.v1' THEN 'has rolled back ' || array_to_string(steps.undone, ', ')
        WHEN 'AssistanceRequested.v1' THEN 'asks ' || steps.helper || ' for help'
        WHEN 'RegistryQueried.v1' THEN 'asks the registry for ' || steps.capability
        WHEN 'ReassignmentDecided.v1' THEN 'evaluates reassignment'
        WHEN 'SupervisorCalled.v1' THEN 'asks ' || steps.supervisor
        WHEN 'RecoveryEscalated.v1' THEN 'leaves ' || steps.level || ' for ' || steps.to_level
        ELSE 'resolved'
    END AS what,
    CASE
        WHEN steps.type IN ('RecoveryAttempted.v1', 'AssistanceRequested.v1') AND answers.answer IS NOT NULL
            THEN answers.answer
        WHEN steps.type = 'RecoveryAttempted.v1' AND lead(steps.type) OVER in_order IS NOT NULL
            THEN if(lead(steps.type) OVER in_order = 'FailureResolved.v1', 'success', 'failure')
        WHEN steps.type = 'AssistanceRequested.v1' AND lead(steps.type) OVER in_order IS NOT NULL
            THEN if(lead(steps.type) OVER in_order = 'FailureResolved.v1', 'helped', 'no help')
        WHEN steps.type = 'RegistryQueried.v1' AND len(steps.candidates) = 0 THEN 'no peer'
        WHEN steps.type = 'RegistryQueried.v1' THEN array_to_string(steps.candidates, ', ')
        WHEN steps.type = 'ReassignmentDecided.v1' AND steps.helper IS NULL THEN concat_ws(': ', 'infeasible', reason)
        WHEN steps.type = 'ReassignmentDecided.v1' THEN 'to ' || concat_ws(' from ', steps.helper, checkpoint)
        WHEN steps.type = 'SupervisorCalled.v1' AND failures.resolved_level = 'human' THEN 'resolved'
        WHEN steps.type = 'RecoveryEscalated.v1' THEN steps.reason
    END AS result,
    answers.achieved
FROM failures
-- A question to the registry, and a call, name no failure: they are about the one that is not resolved yet.
INNER JOIN steps
    ON
        failures.run_id = steps.run_id AND failures.action_id = steps.action_id AND failures.seq < steps.seq
        AND CASE
            WHEN steps.type IN ('RegistryQueried.v1', 'SupervisorCalled.v1')
                THEN steps.time_us <= coalesce(failures.resolved_us, steps.time_us)
            ELSE
                failures.failure = steps.failure
                AND steps.type IN (
                    'RecoveryAttempted.v1', 'AttemptRolledBack.v1', 'RecoveryEscalated.v1', 'AssistanceRequested.v1',
                    'ReassignmentDecided.v1', 'FailureResolved.v1'
                )
        END
LEFT JOIN answers
    ON
        steps.run_id = answers.run_id AND steps.action_id = answers.action_id AND steps.failure = answers.failure
        AND steps.number IS NOT DISTINCT FROM answers.number AND steps.helper IS NOT DISTINCT FROM answers.helper
        AND steps.type <> 'AttemptRolledBack.v1'
WINDOW in_order AS (PARTITION BY failures.run_id, failures.action_id, failures.failure ORDER BY steps.seq)
