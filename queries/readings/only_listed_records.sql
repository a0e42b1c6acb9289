-- Title: Only requests, executions, recoveries and escalations are records
-- Paper: sec:evaluation:metrics
-- Reading: R16
-- Question: which events are records
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: The definition lists these four and no more.
-- Grain: one row per record
-- Key: run_id, seq
-- Units: as in coordination_events
-- NULL: as in coordination_events
-- Example: fsar-ledger query readings/only_listed_records LEDGER
SELECT *
FROM coordination_events
WHERE record_kind IN ('request', 'execution', 'recovery', 'escalation')
