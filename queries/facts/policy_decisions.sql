-- Title: Decisions on delegated requests, and whose policy did not allow them then
-- Paper: eq:policy
-- Grain: one row per admission, command, refusal for any reason and call for review of a step that one robot delegates
--   to another
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: executor where none is named; is_against_* when the run does not observe policy, is_heeded when no record shows
--   it and the run does not observe request and supervision; is_against_*: that policy had not allowed it for at least
--   a second (two messages); is_heeded: it was refused, put to review, or approved in one
-- Example: fsar-ledger query facts/policy_decisions LEDGER
-- Stored: the evidence of governance reads it twice
WITH judgements AS (
    SELECT
        run_id, seq, time_us, task_id, action_id,
        type = 'RequestDenied.v1' AS is_refused,
        coalesce(executed_by, robot, 'robot/' || nullif(split_part(decided_by, '/', 2), '')) AS executor
    FROM request_events
    WHERE type IN ('RequestAdmitted.v1', 'CommandIssued.v1', 'RequestDenied.v1')
    UNION ALL
    SELECT run_id, seq, time_us, task_id, action_id, TRUE AS is_refused, robot AS executor
    FROM supervisor_called
    WHERE purpose = 'review'
),

decided AS (
    SELECT
        judgements.run_id, judgements.seq, judgements.time_us, judgements.task_id,
        judgements.is_refused OR coalesce(answers.is_approved, FALSE) AS is_heeded,
        judgements.executor
    FROM judgements
    ASOF LEFT JOIN review_answers AS answers
        ON
            judgements.run_id = answers.run_id AND judgements.action_id = answers.action_id
            AND judgements.seq > answers.seq
),

asked AS (
    SELECT
        decided.run_id, decided.seq, decided.time_us, decided.task_id, decided.is_heeded, decided.executor,
        steps.robot AS requester,
        steps.capability
    FROM decided
    ASOF JOIN step_began AS steps
        ON decided.run_id = steps.run_id AND decided.task_id = steps.task_id AND decided.seq > steps.seq
    WHERE steps.target_role IS NOT NULL
)

SELECT
    asked.run_id, asked.seq, asked.time_us, asked.requester, asked.executor,
    asked.is_heeded OR if(any_value(list_has_all(runs.observes, ['request', 'supervision'])), FALSE, NULL)
        AS is_heeded,
    coalesce(
        bool_or(windows.scope = 'local' AND windows.robot = asked.requester),
        if(any_value(list_contains(runs.observes, 'policy')), FALSE, NULL)
    ) AS is_against_requester,
    coalesce(
        bool_or(windows.scope = 'fleet' AND windows.robot = asked.executor),
        if(any_value(list_contains(runs.observes, 'policy')), FALSE, NULL)
    ) AS is_against_fleet
FROM asked
INNER JOIN runs ON asked.run_id = runs.run_id
LEFT JOIN policy_windows AS windows
    ON
        asked.run_id = windows.run_id AND windows.robot IN (asked.requester, asked.executor)
        AND windows.outcome <> 'allow' AND (windows.capability IS NULL OR asked.capability = windows.capability)
        AND (windows.context IS NULL OR asked.task_id = windows.context)
        AND windows.opened_us + 1000000 <= asked.time_us
        AND asked.time_us < coalesce(windows.closed_us, asked.time_us + 1)
GROUP BY asked.run_id, asked.seq, asked.time_us, asked.requester, asked.executor, asked.is_heeded
