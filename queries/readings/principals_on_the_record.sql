-- Title: Each principal must stand on the record itself
-- Paper: sec:evaluation:metrics
-- Reading: R8
-- Question: where a principal may be found
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: We check whether the audit trace jointly records the three, for each event.
-- Grain: one row per record
-- Key: run_id, seq
-- Units: as in coordination_events
-- NULL: as in coordination_events
-- Example: fsar-ledger query readings/principals_on_the_record LEDGER
SELECT
    * REPLACE (
        has_origin AND requested_by IS NOT NULL AS has_origin,
        has_executor AND executed_by IS NOT NULL AS has_executor,
        has_supervisor AND (supervised_by IS NOT NULL OR is_off_shift) AS has_supervisor,
        is_attributable
        AND requested_by IS NOT NULL
        AND executed_by IS NOT NULL
        AND (supervised_by IS NOT NULL OR is_off_shift) AS is_attributable
    )
FROM coordination_events
