-- Title: A record whose supervisor is off shift lacks one
-- Paper: sec:evaluation:metrics
-- Reading: R8
-- Question: whether an absent supervisor is required
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: Nobody supervised at that moment, and the record names nobody; H_F oversees what a local supervisor does not,
--   but does not stand in.
-- Grain: one row per record
-- Key: run_id, seq
-- Units: as in coordination_events
-- NULL: as in coordination_events
-- Example: fsar-ledger query readings/absent_supervisors_are_missing LEDGER
SELECT
    * REPLACE (
        has_supervisor AND NOT is_off_shift AS has_supervisor,
        is_attributable AND NOT is_off_shift AS is_attributable
    )
FROM coordination_events
