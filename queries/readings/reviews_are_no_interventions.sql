-- Title: A review by the fleet supervisor is no intervention
-- Paper: sec:model:supervision
-- Reading: R37
-- Question: which calls are interventions
-- Replaces: fleet_calls
-- Moves: human_intervention
-- Why: Fleet supervision intervenes only when cross-robot conflicts require it; a review that policy asks for is
--   oversight as planned.
-- Grain: one row per call
-- Key: run_id, seq
-- Units: as in fleet_calls
-- NULL: as in fleet_calls
-- Example: fsar-ledger query readings/reviews_are_no_interventions LEDGER
SELECT *
FROM fleet_calls
WHERE purpose IS DISTINCT FROM 'review'
