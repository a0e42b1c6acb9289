-- Title: A request that a federation service closes is closed by its requester
-- Paper: sec:evaluation:metrics
-- Reading: R4
-- Question: who decides a closing
-- Replaces: decisions
-- Moves: governance_locality
-- Why: In the worked computation the requester detects the completion, one of the nine local decisions of FSAR.
-- Grain: one row per decision
-- Key: run_id, seq
-- Units: as in decisions
-- NULL: as in decisions
-- Example: fsar-ledger query readings/closings_are_the_requesters LEDGER
SELECT
    * REPLACE (
        is_local OR coalesce(decision_kind = 'closing' AND starts_with(decided_by, 'service/'), FALSE) AS is_local
    )
FROM decisions
