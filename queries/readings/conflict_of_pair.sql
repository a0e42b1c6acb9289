-- Title: Each pair of principals that hold one dimension of an action at once is a conflict
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: what one conflict is
-- Replaces: conflicts
-- Moves: authority_conflicts
-- Why: Two or more principals claim at once: three that do are three times two.
-- Grain: one row per run, action, dimension and pair of principals whose claims overlap
-- Key: none, each row is a pair of principals
-- Units: as in conflicts
-- NULL: as in conflicts
-- Example: fsar-ledger query readings/conflict_of_pair LEDGER
SELECT
    one.run_id, one.action_id, one.dimension,
    min(greatest(one.began_us, other.began_us)) AS began_us
FROM held_claims AS one
INNER JOIN held_claims AS other
    ON
        one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension
        AND one.claimant < other.claimant AND one.began_us < other.ended_us AND one.ended_us > other.began_us
GROUP BY one.run_id, one.action_id, one.dimension, one.claimant, other.claimant
