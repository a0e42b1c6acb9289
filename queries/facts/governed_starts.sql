-- Title: Executions and motions that policy governs, with the true policy at their start
-- Paper: eq:policy, app:foundations
-- Grain: one row per ExecutionStarted event and per RoutinePerformed event whose operation is motion
-- Key: run_id, seq
-- Units: started_us microseconds of run time; under_seqs positions in the run of the windows and rules in force then
-- NULL: action_id, on_behalf_of for a motion; outcome, under_seqs, is_approved, is_violation where the run does not
--   observe them
-- Example: fsar-ledger query facts/governed_starts LEDGER
-- Stored: three metrics and I3 read it
WITH starts AS (
    SELECT run_id, seq, time_us AS started_us, task_id, action_id, robot, on_behalf_of, capability
    FROM execution_events
    WHERE type = 'ExecutionStarted.v1' OR (type = 'RoutinePerformed.v1' AND operation = 'motion')
),

subjects AS (
    -- The policies that count: the executor's own, the fleet's for its zone, and the requester's own.
    SELECT
        starts.run_id, starts.seq, starts.task_id, starts.capability,
        starts.robot AS subject,
        FALSE AS own_only
    FROM starts
    UNION ALL
    SELECT
        starts.run_id, starts.seq, starts.task_id, starts.capability,
        starts.on_behalf_of AS subject,
        TRUE AS own_only
    FROM starts
    WHERE starts.on_behalf_of <> starts.robot
),

checks AS (
    -- Windows that open or close at the time of the start are ordered as in the log. A rule counts if it applies to
    -- this capability and context.
    SELECT
        subjects.run_id, subjects.seq,
        bool_or(windows.outcome = 'deny') AS is_denied,
        list(DISTINCT windows.seq ORDER BY windows.seq) AS under_seqs
    FROM subjects
    INNER JOIN policy_windows AS windows
        ON
            subjects.run_id = windows.run_id AND subjects.subject = windows.robot
            AND subjects.seq BETWEEN windows.seq + 1 AND coalesce(windows.closed_seq, subjects.seq)
            AND (windows.scope = 'local' OR NOT subjects.own_only)
            AND (windows.capability IS NULL OR subjects.capability = windows.capability)
            AND (windows.context IS NULL OR subjects.task_id = windows.context)
    GROUP BY subjects.run_id, subjects.seq
),

judged AS (
    SELECT
        starts.run_id, starts.seq, starts.started_us, starts.action_id, starts.robot, starts.on_behalf_of,
        CASE
            WHEN checks.is_denied THEN 'deny'
            WHEN checks.run_id IS NOT NULL THEN 'review'
            WHEN list_contains(runs.observes, 'policy') THEN 'allow'
        END AS outcome,
        coalesce(answers.is_approved, if(list_contains(runs.observes, 'supervision'), FALSE, NULL)) AS is_approved,
        if(list_contains(runs.observes, 'policy'), coalesce(checks.under_seqs, []), NULL) AS under_seqs
    FROM starts
    INNER JOIN runs ON starts.run_id = runs.run_id
    LEFT JOIN checks ON starts.run_id = checks.run_id AND starts.seq = checks.seq
    -- The last answer before the start: a refusal revokes an approval.
    ASOF LEFT JOIN review_answers AS answers
        ON starts.run_id = answers.run_id AND starts.action_id = answers.action_id AND starts.seq > answers.seq
)

SELECT
    run_id, seq, started_us, action_id, robot, on_behalf_of, outcome, is_approved,
    outcome = 'deny' OR (outcome = 'review' AND NOT is_approved) AS is_violation,
    under_seqs
FROM judged
