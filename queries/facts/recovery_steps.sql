-- Title: What recovery did about each failure, step by step, and what came of it
-- Paper: eq:recovery, fig:wf3
-- Grain: one row per failure and attempt, question to registry, peer or supervisor, reassignment decision, escalation or resolution
-- Units: detected_us, time_us, until_us microseconds of run time; until_us is when the next step was taken
-- NULL: decided_by when the record names none; result when nothing came of it or none is recorded; until_us of the last step
-- Example: fsar-ledger query facts/recovery_steps LEDGER
WITH records AS (
    SELECT
        failures.run_id,
        failures.action_id,
        failures.failure,
        failures.detected_us,
        failures.resolved_level,
        events.seq,
        events.type,
        events.time_us,
        events.decided_by,
        events.to_level,
        events.deadline_us,
        events.number,
        events.helper,
        events.supervisor,
        events.capability,
        events.candidates,
        events.checkpoint,
        events.reason AS said,
        CASE events.type
            WHEN 'RegistryQueried.v1' THEN 'peer' WHEN 'ReassignmentDecided.v1' THEN 'fleet' WHEN 'SupervisorCalled.v1' THEN 'human' ELSE events.level
        END AS level
    FROM failures
    INNER JOIN events
        ON failures.run_id = events.run_id AND failures.action_id = coalesce(events.failed_action, events.action_id) AND failures.seq < events.seq
    WHERE
        CASE
            WHEN events.type IN ('RecoveryAttempted.v1', 'RecoveryEscalated.v1', 'AssistanceRequested.v1', 'ReassignmentDecided.v1', 'FailureResolved.v1')
                THEN failures.failure = events.failure
            WHEN events.type = 'RegistryQueried.v1' OR (events.type = 'SupervisorCalled.v1' AND events.purpose = 'recovery')
                THEN events.time_us <= coalesce(failures.resolved_us, events.time_us)
            ELSE FALSE
        END
),

followed AS (
    SELECT
        records.*,
        answers.answer,
        answers.achieved,
        lead(records.time_us) OVER in_order AS until_us,
        lead(records.type) OVER in_order AS next_type
    FROM records
    LEFT JOIN recovery_answers AS answers
        ON
            records.run_id = answers.run_id AND records.action_id = answers.action_id AND records.failure = answers.failure
            AND records.number IS NOT DISTINCT FROM answers.number AND records.helper IS NOT DISTINCT FROM answers.helper
    WINDOW in_order AS (PARTITION BY records.run_id, records.action_id, records.failure ORDER BY records.seq)
)

SELECT
    followed.* EXCLUDE (answer, next_type),
    CASE type
        WHEN 'RecoveryAttempted.v1' THEN 'attempt ' || number
        WHEN 'AssistanceRequested.v1' THEN 'asks ' || helper || ' for help'
        WHEN 'RegistryQueried.v1' THEN 'asks the registry for ' || capability
        WHEN 'ReassignmentDecided.v1' THEN 'evaluates reassignment'
        WHEN 'SupervisorCalled.v1' THEN 'asks ' || supervisor
        WHEN 'RecoveryEscalated.v1' THEN 'leaves ' || level || ' for ' || to_level
        ELSE 'resolved'
    END AS what,
    CASE type
        WHEN 'RecoveryAttempted.v1' THEN coalesce(answer, if(next_type = 'FailureResolved.v1', 'success', if(next_type IS NULL, NULL, 'failure')))
        WHEN 'AssistanceRequested.v1' THEN coalesce(answer, if(next_type = 'FailureResolved.v1', 'helped', if(next_type IS NULL, NULL, 'no help')))
        WHEN 'RegistryQueried.v1' THEN if(len(candidates) = 0, 'no peer', array_to_string(candidates, ', '))
        WHEN 'ReassignmentDecided.v1'
            THEN if(helper IS NULL, 'infeasible' || coalesce(': ' || said, ''), 'to ' || helper || coalesce(' from ' || checkpoint, ''))
        WHEN 'SupervisorCalled.v1' THEN if(resolved_level = 'human', 'resolved', NULL)
        WHEN 'RecoveryEscalated.v1' THEN said
    END AS result
FROM followed
