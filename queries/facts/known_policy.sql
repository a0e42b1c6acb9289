-- Title: Executions and motions that policy governs, with the composed outcome that was known at the start
-- Paper: eq:policy, app:foundations
-- Grain: one row per ExecutionStarted event and per RoutinePerformed event whose operation is motion
-- Key: run_id, seq
-- Units: time_us microseconds of run time; denied_seq position in the run
-- NULL: action_id for a motion; denied_seq without a refusal that still stands; outcome other than deny unless the run
--   observes all policies involved
-- Example: fsar-ledger query facts/known_policy LEDGER
-- Stored: I3 and A3 both read it
WITH said AS (
    -- A refusal counts for the robot that it names; one that names no robot counts for all.
    SELECT
        run_id, seq, action_id, type, outcome,
        CASE type WHEN 'RequestDenied.v1' THEN coalesce(
            executed_by, 'robot/' || nullif(regexp_extract(decided_by, '^(?:robot|agent)/([^/]+)', 1), '')
        ) END AS refused_by
    FROM request_events
    WHERE type IN ('RequestAdmitted.v1', 'RequestDenied.v1')
),

starts AS (
    SELECT
        done.run_id, done.seq, done.time_us, done.type, done.task_id, done.action_id, done.robot, done.capability,
        if(any_value(answers.is_approved), any_value(answers.seq), -1) AS approved_seq,
        max(said.seq) FILTER (said.type = 'RequestAdmitted.v1' AND said.outcome <> 'deny') AS admitted_seq,
        max(said.seq) FILTER (said.type = 'RequestDenied.v1') AS denied_seq
    FROM execution_events AS done
    LEFT JOIN said
        ON
            done.run_id = said.run_id AND done.action_id = said.action_id AND done.seq > said.seq
            AND done.robot = coalesce(said.refused_by, done.robot)
    ASOF LEFT JOIN review_answers AS answers
        ON done.run_id = answers.run_id AND done.action_id = answers.action_id AND done.seq > answers.seq
    WHERE done.type = 'ExecutionStarted.v1' OR (done.type = 'RoutinePerformed.v1' AND done.operation = 'motion')
    GROUP BY done.run_id, done.seq, done.time_us, done.type, done.task_id, done.action_id, done.robot, done.capability
),

outcomes AS (
    -- Until it starts, the executor knows its own policy, and the fleet's rules, which reach all robots at once (R34).
    SELECT starts.run_id, starts.seq, windows.seq AS known_seq, windows.outcome
    FROM starts
    INNER JOIN policy_windows AS windows
        ON
            starts.run_id = windows.run_id AND starts.robot = windows.robot
            AND (windows.scope = 'local' OR windows.window_name IS NULL)
            AND starts.seq BETWEEN windows.seq + 1 AND coalesce(windows.closed_seq, starts.seq)
            AND (windows.capability IS NULL OR starts.capability = windows.capability)
            AND (windows.context IS NULL OR starts.task_id = windows.context)
    UNION ALL
    SELECT starts.run_id, starts.seq, rules.seq AS known_seq, rules.outcome -- the last one that the executor was told
    FROM starts
    ASOF JOIN fleet_rule_learned AS rules
        ON starts.run_id = rules.run_id AND starts.robot = rules.robot AND starts.seq > rules.seq
    UNION ALL
    SELECT starts.run_id, starts.seq, carried.seq AS known_seq, carried.outcome -- the requester's and a relay's
    FROM starts
    INNER JOIN policies_carried AS carried
        ON
            starts.run_id = carried.run_id AND starts.action_id = carried.action_id
            AND starts.seq BETWEEN carried.seq + 1 AND coalesce(carried.replaced_seq, starts.seq)
)

SELECT
    starts.run_id, starts.seq, starts.time_us, starts.type, starts.action_id, starts.robot,
    CASE
        WHEN bool_or(outcomes.outcome = 'deny') THEN 'deny'
        WHEN any_value(list_has_all(runs.observes, ['policy', 'request', 'knowledge']) OR hidden.run_id IS NULL)
            THEN if(coalesce(bool_or(outcomes.outcome = 'review'), FALSE), 'review', 'allow')
    END AS outcome,
    if(starts.denied_seq > greatest(starts.approved_seq, starts.admitted_seq), starts.denied_seq, NULL) AS denied_seq
FROM starts
INNER JOIN runs ON starts.run_id = runs.run_id
-- A run that records the types and fields of A3 observes these policies.
LEFT JOIN unobservable AS hidden ON starts.run_id = hidden.run_id AND hidden.judge = 'a3_no_silent_policy_override'
-- A supervisor approves the reviews known by then, or by the admission that follows; a denial still stands.
LEFT JOIN outcomes
    ON
        starts.run_id = outcomes.run_id AND starts.seq = outcomes.seq
        AND (outcomes.outcome = 'deny' OR if(approved_seq < 0, -1, greatest(approved_seq, admitted_seq)) < known_seq)
GROUP BY ALL
