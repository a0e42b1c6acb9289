-- Title: The windows and rules under which each request was denied, as whoever decided had last seen them
-- Paper: eq:policy, eq:admissible, app:foundations
-- Grain: one row per RequestDenied event for policy, a bid, an own step or a review and policy window or rule that
--   held for it: of the executor (its own, the fleet's for it), or of the requester or relay as the request carried it
-- Key: run_id, seq, ground_seq
-- Units: opened_us, closed_us microseconds of run time, half-open; seq, ground_seq positions in the run
-- NULL: window for a rule, which has no name but its ground_seq; closed_us when it was never closed or replaced; no row
--   for a denial that no window or rule on record explains
-- Example: fsar-ledger query facts/denial_grounds LEDGER
WITH denied AS (
    SELECT
        run_id, seq, time_us, task_id, action_id, reason, decided_by,
        coalesce(executed_by, 'robot/' || nullif(split_part(decided_by, '/', 2), '')) AS robot,
        if(reason = 'review', 'review', 'deny') AS outcome
    FROM request_denied
    WHERE reason IN ('policy', 'bid', 'own step', 'review')
),

copied AS (
    SELECT
        run_id, seq, time_us,
        'coordinator' AS decided_by
    FROM copy_synced
),

asked AS (
    SELECT
        denied.run_id, denied.seq, denied.time_us, denied.task_id, denied.action_id, denied.reason, denied.robot,
        denied.outcome,
        coalesce(issued.capability, steps.capability) AS capability,
        -- Planners and the coordinator decide by their last snapshot or copy of a robot's own policy.
        coalesce(snapshots.time_us, copied.time_us, denied.time_us) AS local_us,
        coalesce(
            learned.as_of_us, if(denied.run_id IN (SELECT run_id FROM fleet_rule_learned), -1, denied.time_us)
        ) AS fleet_us
    FROM denied
    ASOF LEFT JOIN request_issued AS issued
        ON denied.run_id = issued.run_id AND denied.action_id = issued.action_id AND denied.seq > issued.seq
    ASOF LEFT JOIN step_began AS steps
        ON denied.run_id = steps.run_id AND denied.task_id = steps.task_id AND denied.seq > steps.seq
    ASOF LEFT JOIN snapshot_taken AS snapshots
        ON denied.run_id = snapshots.run_id AND denied.robot = snapshots.robot AND denied.seq > snapshots.seq
    ASOF LEFT JOIN copied
        ON denied.run_id = copied.run_id AND denied.decided_by = copied.decided_by AND denied.seq > copied.seq
    ASOF LEFT JOIN fleet_rule_learned AS learned
        ON denied.run_id = learned.run_id AND denied.robot = learned.robot AND denied.seq > learned.seq
),

seen AS (
    SELECT
        run_id, seq, task_id, capability, outcome, robot,
        'local' AS scope,
        unnest([TRUE, FALSE]) AS is_window,
        unnest([local_us, time_us]) AS seen_us
    FROM asked
    UNION ALL
    SELECT
        run_id, seq, task_id, capability, outcome, robot,
        'fleet' AS scope,
        unnest([TRUE, FALSE]) AS is_window,
        unnest([fleet_us, time_us]) AS seen_us
    FROM asked
    WHERE reason IN ('policy', 'review')
    UNION ALL
    SELECT
        asked.run_id, asked.seq, asked.task_id, asked.capability, asked.outcome,
        requests.decided_by AS robot,
        'local' AS scope,
        unnest([TRUE, FALSE]) AS is_window,
        requests.time_us AS seen_us
    FROM asked
    INNER JOIN request_events AS requests
        ON
            asked.run_id = requests.run_id AND asked.action_id = requests.action_id AND asked.seq > requests.seq
            AND asked.outcome = requests.carried_policy
    WHERE requests.type IN ('RequestIssued.v1', 'RequestRelayed.v1')
)

SELECT DISTINCT
    seen.run_id, seen.seq,
    windows.seq AS ground_seq,
    windows."window",
    windows.robot, windows.scope, windows.outcome, windows.opened_us, windows.closed_us
FROM seen
INNER JOIN policy_windows AS windows
    ON
        seen.run_id = windows.run_id AND seen.robot = windows.robot AND seen.scope = windows.scope
        AND seen.outcome = windows.outcome AND seen.is_window = (windows."window" IS NOT NULL)
        AND seen.seq > windows.seq AND seen.seen_us >= windows.opened_us
        AND seen.seen_us < coalesce(windows.closed_us, seen.seen_us + 1)
        AND (windows.capability IS NULL OR seen.capability = windows.capability)
        AND (windows.context IS NULL OR seen.task_id = windows.context)
