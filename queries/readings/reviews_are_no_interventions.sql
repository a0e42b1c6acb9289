-- Title: A review by the fleet supervisor is no intervention
-- Paper: sec:model:supervision
-- Reading: R37
-- Question: which calls are interventions
-- Replaces: interventions
-- Moves: human_intervention
-- Why: Fleet supervision intervenes only when cross-robot conflicts require it; a review that policy asks for is
--   oversight as planned.
-- Grain: one row per call
-- Key: run_id, seq
-- Units: as in interventions
-- NULL: as in interventions
-- Example: fsar-ledger query readings/reviews_are_no_interventions LEDGER
SELECT *
FROM interventions
WHERE purpose IS DISTINCT FROM 'review'
