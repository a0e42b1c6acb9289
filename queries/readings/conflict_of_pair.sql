-- Title: Each pair of principals that hold one dimension of an action at once is a conflict
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: what counts as one conflict
-- Replaces: conflicts
-- Moves: authority_conflicts
-- Why: Two or more principals claim at once: three that do are three times two.
-- Grain: one row per run, action, dimension and pair of principals whose claims overlap
-- Key: none, each row is a pair of principals
-- Units: as in conflicts
-- NULL: as in conflicts
-- Example: fsar-ledger query readings/conflict_of_pair LEDGER
SELECT
    run_id, action_id, dimension,
    min(from_us) AS began_us
FROM claim_overlaps
GROUP BY run_id, action_id, dimension, one_claimant, other_claimant
