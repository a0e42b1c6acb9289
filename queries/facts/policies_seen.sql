-- Title: Each denial that a policy can explain: for which capability, and at which moments its decider saw the policies
-- Paper: eq:policy, eq:admissible
-- Grain: one row per RequestDenied event for policy, a bid, an own step or a review
-- Key: run_id, seq
-- Units: time_us microseconds of run time; local_us, fleet_us when the decider last saw the executor's own policy and
--   the fleet's policy for it, fleet_us -1 when it never had learned a rule of the fleet
-- NULL: a principal, task or action that the record does not name; capability when no record before names one
-- Example: fsar-ledger query facts/policies_seen LEDGER
WITH denied AS (
    SELECT
        run_id, seq, time_us, task_id, action_id, reason, decided_by,
        coalesce(executed_by, 'robot/' || nullif(split_part(decided_by, '/', 2), '')) AS robot,
        if(reason = 'review', 'review', 'deny') AS outcome
    FROM request_denied
    WHERE reason IN ('policy', 'bid', 'own step', 'review')
),

issued AS (
    -- In the DuckDB before ours, which may read this in a file, ASOF joins NULL to NULL.
    SELECT run_id, seq, action_id, capability
    FROM request_issued
    WHERE action_id IS NOT NULL
),

copied AS (
    SELECT
        run_id, seq, time_us,
        'coordinator' AS decided_by
    FROM copy_synced
)

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
ASOF LEFT JOIN issued
    ON denied.run_id = issued.run_id AND denied.action_id = issued.action_id AND denied.seq > issued.seq
ASOF LEFT JOIN step_began AS steps
    ON denied.run_id = steps.run_id AND denied.task_id = steps.task_id AND denied.seq > steps.seq
ASOF LEFT JOIN snapshot_taken AS snapshots
    ON denied.run_id = snapshots.run_id AND denied.robot = snapshots.robot AND denied.seq > snapshots.seq
ASOF LEFT JOIN copied
    ON denied.run_id = copied.run_id AND denied.decided_by = copied.decided_by AND denied.seq > copied.seq
ASOF LEFT JOIN fleet_rule_learned AS learned
    ON denied.run_id = learned.run_id AND denied.robot = learned.robot AND denied.seq > learned.seq
