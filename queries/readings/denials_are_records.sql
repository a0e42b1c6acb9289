-- Title: A denial is a record, too
-- Paper: sec:evaluation:metrics
-- Reading: R16
-- Question: whether a denial is a record
-- Replaces: event_classes
-- Moves: audit_attributability
-- Why: Locality counts denials among coordination decisions; what is a decision of coordination may be an event of it.
-- Grain: one row per event type that is a decision or a coordination event
-- Key: type
-- Units: as in event_classes
-- NULL: as in event_classes
-- Example: fsar-ledger query readings/denials_are_records LEDGER
SELECT
    * REPLACE (
        CASE WHEN decision_kind = 'denial' THEN 'denial' ELSE record_kind END AS record_kind,
        requires_origin OR decision_kind IS NOT DISTINCT FROM 'denial' AS requires_origin,
        requires_executor OR decision_kind IS NOT DISTINCT FROM 'denial' AS requires_executor,
        requires_supervisor OR decision_kind IS NOT DISTINCT FROM 'denial' AS requires_supervisor
    )
FROM event_classes
