-- Title: A standing denial is decided again each time it is checked
-- Paper: sec:evaluation:metrics
-- Reading: R16
-- Question: how often a standing denial is decided
-- Replaces: decisions
-- Moves: governance_locality
-- Why: Each coordination decision in the audit trace counts, and each look at a step that waits leaves a denial there.
-- Grain: one row per decision
-- Key: run_id, seq
-- Units: as in decisions
-- NULL: as in decisions
-- Example: fsar-ledger query readings/denials_decide_each_time LEDGER
SELECT *
FROM decisions
UNION ALL BY NAME
SELECT
    events.run_id, events.seq, events.time_us, events.type, classes.decision_kind, events.task_id, events.action_id,
    events.decided_by, events.path,
    coalesce(
        len(events.path) = 1
        AND (starts_with(events.decided_by, 'robot/') OR starts_with(events.decided_by, 'supervisor/')),
        FALSE
    ) AS is_local
FROM event_principals AS events
INNER JOIN event_classes AS classes ON events.type = classes.type
ANTI JOIN decisions ON events.run_id = decisions.run_id AND events.seq = decisions.seq
WHERE classes.decision_kind = 'denial' AND len(events.path) > 0
