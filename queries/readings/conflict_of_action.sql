-- Title: An action with authority conflicts in several dimensions is one conflict
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: what counts as one conflict
-- Replaces: conflicts
-- Moves: authority_conflicts
-- Why: Execution authority, override authority or audit responsibility for the same action: an event in which any of
--   them is claimed twice is one event.
-- Grain: one row per run and action in which any dimension conflicts
-- Key: run_id, action_id, dimension
-- Units: as in conflicts
-- NULL: as in conflicts
-- Example: fsar-ledger query readings/conflict_of_action LEDGER
SELECT
    run_id, action_id,
    arg_min(dimension, (began_us, dimension)) AS dimension,
    min(began_us) AS began_us
FROM conflicts
GROUP BY run_id, action_id
