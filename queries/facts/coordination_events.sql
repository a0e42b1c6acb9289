-- Title: Coordination events, and which principals each lets an auditor recover
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per event of a coordination type
-- Units: time_us microseconds of run time
-- NULL: a principal that the row itself does not record; action_id when the record is not correlated with an action
-- Example: fsar-ledger query facts/coordination_events LEDGER
WITH records AS (
    SELECT
        events.run_id,
        events.seq,
        events.time_us,
        events.type,
        event_classes.record_kind,
        events.task_id,
        events.action_id,
        events.requested_by,
        events.executed_by,
        events.supervised_by,
        events.requested_by IS NULL AND event_classes.requires_origin AS lacks_origin,
        events.executed_by IS NULL AND event_classes.requires_executor AS lacks_executor,
        events.supervised_by IS NULL AND event_classes.requires_supervisor AS lacks_supervisor
    FROM events
    INNER JOIN event_classes ON events.type = event_classes.type
    WHERE event_classes.record_kind IS NOT NULL
),

action_principals AS (
    SELECT
        run_id,
        action_id,
        count(requested_by) > 0 AS has_origin,
        count(executed_by) > 0 AS has_executor,
        count(supervised_by) > 0 AS has_supervisor
    FROM events
    WHERE action_id IS NOT NULL
    GROUP BY run_id, action_id
),

judged AS (
    SELECT
        records.*,
        NOT records.lacks_origin OR coalesce(action_principals.has_origin, FALSE) AS has_origin,
        NOT records.lacks_executor OR coalesce(action_principals.has_executor, FALSE) AS has_executor,
        NOT records.lacks_supervisor OR coalesce(action_principals.has_supervisor, FALSE) AS has_supervisor
    FROM records
    LEFT JOIN action_principals ON records.run_id = action_principals.run_id AND records.action_id = action_principals.action_id
)

SELECT
    run_id,
    seq,
    time_us,
    type,
    record_kind,
    task_id,
    action_id,
    requested_by,
    executed_by,
    supervised_by,
    has_origin,
    has_executor,
    has_supervisor,
    has_origin AND has_executor AND has_supervisor AS is_attributable
FROM judged
