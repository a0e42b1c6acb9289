-- Title: Closing a request is no decision
-- Paper: sec:evaluation:metrics
-- Reading: R4
-- Question: who decides a closing
-- Replaces: decisions
-- Moves: governance_locality
-- Why: The definition lists requests, delegations, escalations and denials, and what closes a request decides nothing
--   any more.
-- Grain: one row per decision
-- Key: run_id, seq
-- Units: as in decisions
-- NULL: as in decisions
-- Example: fsar-ledger query readings/closings_decide_nothing LEDGER
SELECT *
FROM decisions
WHERE decision_kind <> 'closing'
