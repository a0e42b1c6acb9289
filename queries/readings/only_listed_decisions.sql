-- Title: Only requests, delegations, escalations and denials are decisions
-- Paper: sec:evaluation:metrics
-- Reading: R42
-- Question: which decisions count
-- Replaces: decisions
-- Moves: governance_locality
-- Why: The definition lists these four and no more.
-- Grain: one row per decision
-- Key: run_id, seq
-- Units: as in decisions
-- NULL: as in decisions
-- Example: fsar-ledger query readings/only_listed_decisions LEDGER
SELECT *
FROM decisions
WHERE decision_kind IN ('request', 'delegation', 'escalation', 'denial')
