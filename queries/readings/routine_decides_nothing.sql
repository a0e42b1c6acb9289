-- Title: Routine operations are no decisions
-- Paper: sec:evaluation:metrics
-- Reading: R42
-- Question: which decisions count
-- Replaces: decisions
-- Moves: governance_locality
-- Why: A coordination decision is about requests, delegations, escalations and denials; only the worked computation
--   counts a robot-local event, an actuator's self-check.
-- Grain: one row per decision
-- Key: run_id, seq
-- Units: as in decisions
-- NULL: as in decisions
-- Example: fsar-ledger query readings/routine_decides_nothing LEDGER
SELECT *
FROM decisions
WHERE decision_kind <> 'routine'
