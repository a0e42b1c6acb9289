-- Title: Denials and calls for review that a policy can explain: the capability, and when the decider saw the policies
-- Paper: eq:policy, eq:admissible, eq:supervision
-- Grain: one row per RequestDenied event for policy, a bid, an own step or a review, and per SupervisorCalled event for
--   review
-- Key: run_id, seq
-- Units: time_us microseconds of run time; decided_seq, decided_us position and time of the decision by policy: of the
--   call for a denial after a review, of the bid for a call about a bid, else of the event; local_us, fleet_us when the
--   decider last saw the executor's own policy and the fleet's policy for it, fleet_us -1 when it had never learned a
--   rule of the fleet
-- NULL: a principal, task or action that the record does not name; capability when no record before names one;
--   local_us, fleet_us of a decider that is no robot when the run does not observe knowledge
-- Example: fsar-ledger query facts/policies_seen LEDGER
-- Stored: the grounds of each scope read it
-- In DuckDB versions before ours, which may read this in a file, ASOF joins NULL to NULL.
WITH issued AS (
    SELECT run_id, seq, action_id, capability
    FROM request_issued
    WHERE action_id IS NOT NULL
),

judged AS (
    -- A denial after a review has its grounds in the policies at the time of the call.
    SELECT
        denied.run_id, denied.seq, denied.time_us, denied.task_id, denied.action_id,
        coalesce(calls.reason, denied.reason) AS reason,
        if(calls.seq IS NULL, denied.decided_by, calls.decided_by) AS decided_by,
        coalesce(
            calls.robot, denied.executed_by, 'robot/' || nullif(split_part(denied.decided_by, '/', 2), '')
        ) AS robot,
        coalesce(calls.decided_seq, denied.seq) AS decided_seq,
        coalesce(calls.decided_us, denied.time_us) AS decided_us,
        if(denied.reason = 'review', 'review', 'deny') AS outcome
    FROM request_denied AS denied
    ASOF LEFT JOIN review_calls AS calls
        ON
            denied.run_id = calls.run_id AND if(denied.reason = 'review', denied.task_id, NULL) = calls.task_id
            AND denied.seq > calls.seq
    WHERE denied.reason IN ('policy', 'bid', 'own step', 'review')
    UNION ALL
    SELECT
        run_id, seq, time_us, task_id, action_id, reason, decided_by, robot, decided_seq, decided_us,
        'review' AS outcome
    FROM review_calls
),

copied AS (
    SELECT
        run_id, seq, time_us,
        'coordinator' AS decided_by
    FROM copy_synced
)

SELECT
    judged.run_id, judged.seq, judged.time_us, judged.task_id, judged.action_id, judged.reason, judged.robot,
    judged.decided_seq, judged.decided_us, judged.outcome,
    coalesce(issued.capability, steps.capability) AS capability,
    -- Planners and the coordinator use their last snapshot or copy of a robot's own policy.
    coalesce(snapshots.time_us, copied.time_us, if(present.run_id IS NULL, NULL, judged.decided_us)) AS local_us,
    CASE
        WHEN learned.as_of_us IS NOT NULL THEN learned.as_of_us
        WHEN judged.run_id IN (SELECT run_id FROM fleet_rule_learned) THEN -1
        WHEN present.run_id IS NOT NULL THEN judged.decided_us
    END AS fleet_us
FROM judged
-- Where the run does not observe knowledge, what a decider with copies had seen is unknown.
LEFT JOIN runs AS present
    ON
        judged.run_id = present.run_id
        AND (list_contains(present.observes, 'knowledge') OR starts_with(judged.decided_by, 'robot/'))
ASOF LEFT JOIN issued
    ON judged.run_id = issued.run_id AND judged.action_id = issued.action_id AND judged.decided_seq > issued.seq
ASOF LEFT JOIN step_began AS steps
    ON judged.run_id = steps.run_id AND judged.task_id = steps.task_id AND judged.decided_seq > steps.seq
ASOF LEFT JOIN snapshot_taken AS snapshots
    ON judged.run_id = snapshots.run_id AND judged.robot = snapshots.robot AND judged.decided_seq > snapshots.seq
ASOF LEFT JOIN copied
    ON judged.run_id = copied.run_id AND judged.decided_by = copied.decided_by AND judged.decided_seq > copied.seq
ASOF LEFT JOIN fleet_rule_learned AS learned
    ON judged.run_id = learned.run_id AND judged.robot = learned.robot AND judged.decided_seq > learned.seq
