-- Title: A principal may stand on any record of the same action
-- Paper: sec:evaluation:metrics
-- Reading: R8
-- Question: where a principal may be found
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: The score is the share of events for which all three are recoverable; it does not say from what.
-- Grain: one row per record
-- Key: run_id, seq
-- Units: as in coordination_events
-- NULL: as in coordination_events
-- Example: fsar-ledger query readings/principals_of_the_action LEDGER
WITH named AS (
    SELECT
        events.run_id, events.action_id,
        count(events.requested_by) > 0 AS has_origin,
        count(events.executed_by) > 0 AS has_executor,
        count(events.supervised_by) > 0 AS has_supervisor
    FROM event_principals AS events
    INNER JOIN event_classes AS classes ON events.type = classes.type
    WHERE events.action_id IS NOT NULL
    GROUP BY events.run_id, events.action_id
),

recovered AS (
    SELECT
        records.* REPLACE (
            records.has_origin OR coalesce(named.has_origin, FALSE) AS has_origin,
            records.has_executor OR coalesce(named.has_executor, FALSE) AS has_executor,
            records.has_supervisor OR coalesce(named.has_supervisor, FALSE) AS has_supervisor,
            records.is_off_shift AND NOT coalesce(named.has_supervisor, FALSE) AS is_off_shift
        )
    FROM coordination_events AS records
    LEFT JOIN named ON records.run_id = named.run_id AND records.action_id = named.action_id
)

SELECT * REPLACE (has_origin AND has_executor AND has_supervisor AS is_attributable)
FROM recovered
