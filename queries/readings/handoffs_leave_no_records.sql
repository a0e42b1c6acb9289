-- Title: Hand-offs between the agents of one robot are no records
-- Paper: sec:evaluation:qualitative
-- Reading: R21
-- Question: whether internal hand-offs are records
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: The definition lists no hand-offs; a case counts four of them for each action as unattributed.
-- Grain: one row per record
-- Key: run_id, seq
-- Units: as in coordination_events
-- NULL: as in coordination_events
-- Example: fsar-ledger query readings/handoffs_leave_no_records LEDGER
SELECT *
FROM coordination_events
WHERE record_kind <> 'handoff'
