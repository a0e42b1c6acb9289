-- Title: Each pair of principals that hold one dimension of an action at once is a conflict
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: what one conflict is
-- Replaces: conflicts
-- Moves: authority_conflicts
-- Why: Two or more principals claim at once: three that do are three times two.
-- Grain: one row per run, action, dimension and pair of principals whose claims overlap
-- Units: as in conflicts
-- NULL: as in conflicts
-- Example: fsar-ledger query readings/conflict_of_pair LEDGER
WITH held AS (
    SELECT
        run_id,
        seq,
        action_id,
        dimension,
        claimant,
        began_us,
        coalesce(ended_us, 9223372036854775807) AS ended_us
    FROM claims
    WHERE (ended_us IS NULL OR ended_us > began_us) AND action_id IS NOT NULL AND dimension IS NOT NULL AND claimant IS NOT NULL
)

SELECT
    one.run_id,
    one.action_id,
    one.dimension,
    min(greatest(one.began_us, other.began_us)) AS began_us
FROM held AS one
INNER JOIN held AS other
    ON
        one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension AND one.claimant < other.claimant
        AND one.began_us < other.ended_us AND one.ended_us > other.began_us
GROUP BY one.run_id, one.action_id, one.dimension, one.claimant, other.claimant
