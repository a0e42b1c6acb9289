-- Title: Events, and the action that each record names
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per event
-- Key: run_id, seq
-- Units: none
-- NULL: action_id when the record names neither an action nor a failed action nor a request, and its task is no
--   attempt of an outsider
-- Example: fsar-ledger query facts/keyed_events LEDGER
WITH outsiders AS (
    SELECT DISTINCT run_id, task_id
    FROM outsider_request_injected
)

SELECT
    events.run_id, events.seq, events.caused_by, events.type,
    coalesce(events.action_id, events.failed_action, events.request_id, outsiders.task_id) AS action_id
FROM event_principals AS events
LEFT JOIN outsiders ON events.run_id = outsiders.run_id AND events.task_id = outsiders.task_id
