-- Title: Decisions, and whether one principal took each by itself
-- Paper: sec:evaluation:metrics (governance locality)
-- Grain: one row per event of a decision type whose path is not empty
-- Units: time_us microseconds of run time
-- NULL: decided_by when the record names no decider; task_id, action_id when the record is not tied to one
-- Example: fsar-ledger query facts/decisions LEDGER
WITH decision_types AS (
    SELECT
        type,
        decision_kind
    FROM event_classes
    WHERE decision_kind IS NOT NULL
)

SELECT
    events.run_id,
    events.seq,
    events.time_us,
    events.type,
    decision_types.decision_kind,
    events.task_id,
    events.action_id,
    events.decided_by,
    events.path,
    coalesce(
        len(events.path) = 1 AND (starts_with(events.decided_by, 'robot/') OR starts_with(events.decided_by, 'supervisor/')),
        FALSE
    ) AS is_local
FROM events
INNER JOIN decision_types ON events.type = decision_types.type
WHERE len(events.path) > 0
