-- Title: The windows and rules behind each denial and each call for a supervisor's review, as the decider last saw them
-- Paper: eq:policy, eq:admissible, eq:supervision, app:foundations
-- Grain: one row per event of facts/policies_seen and policy window or rule that held for it: of the executor (its own,
--   the fleet's for it), or of the requester or relay as the request carried it; for a review that no policy explains,
--   the supervisor's rule on how often to review
-- Key: run_id, seq, ground_seq, robot
-- Units: opened_us, closed_us microseconds of run time, half-open; seen_us when the decider had last seen it, or, for a
--   policy that the request carried, its sender; seq, ground_seq positions in the run; review_every admissions
-- NULL: window_name for a rule, which has no name but its ground_seq; capability, context when it holds for all of
--   them; closed_us when it was never closed or replaced; scope for a supervisor's rule, review_every for any other; no
--   row for an event that no window or rule on record explains
-- Example: fsar-ledger query facts/policy_grounds LEDGER
-- Stored: a query for one run or action would compute all
WITH seen AS (
    SELECT
        run_id, seq, decided_seq, task_id, capability, outcome, robot,
        'local' AS scope,
        unnest([TRUE, FALSE]) AS is_window,
        unnest([local_us, decided_us]) AS seen_us
    FROM policies_seen
    UNION ALL
    SELECT
        run_id, seq, decided_seq, task_id, capability, outcome, robot,
        'fleet' AS scope,
        unnest([TRUE, FALSE]) AS is_window,
        unnest([fleet_us, decided_us]) AS seen_us
    FROM policies_seen
    WHERE reason IN ('policy', 'review')
    UNION ALL
    SELECT
        policies.run_id, policies.seq, policies.decided_seq, policies.task_id, policies.capability, policies.outcome,
        requests.decided_by AS robot,
        'local' AS scope,
        unnest([TRUE, FALSE]) AS is_window,
        requests.time_us AS seen_us
    FROM policies_seen AS policies
    INNER JOIN request_events AS requests
        ON
            policies.run_id = requests.run_id
            AND policies.action_id = requests.action_id
            AND policies.decided_seq > requests.seq
            AND policies.outcome = requests.carried_policy
    WHERE requests.type IN ('RequestIssued.v1', 'RequestRelayed.v1')
),

under_policy AS (
    SELECT
        seen.run_id, seen.seq,
        windows.seq AS ground_seq,
        windows.window_name, windows.robot, windows.scope, windows.capability, windows.context, windows.outcome,
        windows.opened_us, windows.closed_us,
        max(seen.seen_us) AS seen_us,
        NULL::BIGINT AS review_every
    FROM seen
    INNER JOIN run_started AS runs ON seen.run_id = runs.run_id
    INNER JOIN policy_windows AS windows
        ON
            seen.run_id = windows.run_id AND seen.robot = windows.robot AND seen.scope = windows.scope
            AND seen.outcome = windows.outcome AND seen.is_window = (windows.window_name IS NOT NULL)
            AND seen.decided_seq > windows.seq AND seen.seen_us >= windows.opened_us
            -- Where a run does not record when windows close, how long one held is unknown.
            AND CASE
                WHEN windows.closed_us IS NOT NULL THEN seen.seen_us < windows.closed_us
                WHEN seen.is_window AND NOT list_contains(runs.observes, 'policy')
                    THEN list_contains(runs.records, 'PolicyWindowClosed')
                ELSE TRUE
            END
            AND (windows.capability IS NULL OR seen.capability = windows.capability)
            AND (windows.context IS NULL OR seen.task_id = windows.context)
    GROUP BY ALL
)

SELECT *
FROM under_policy
UNION ALL
SELECT density.*
FROM density_reviews AS density
ANTI JOIN under_policy
    ON density.run_id = under_policy.run_id AND density.seq = under_policy.seq
