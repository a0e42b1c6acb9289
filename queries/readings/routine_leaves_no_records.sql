-- Title: Routine operations are no records
-- Paper: sec:evaluation:metrics
-- Reading: R42
-- Question: which events are records
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: The definition names requests, executions, recoveries and escalations; nobody asks for a routine operation.
-- Grain: one row per record
-- Key: run_id, seq
-- Units: as in coordination_events
-- NULL: as in coordination_events
-- Example: fsar-ledger query readings/routine_leaves_no_records LEDGER
SELECT *
FROM coordination_events
WHERE record_kind <> 'routine'
