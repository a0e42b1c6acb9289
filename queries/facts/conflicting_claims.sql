-- Title: The claims that make each authority conflict: held at once by distinct principals
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per conflict (conflicts)
-- Key: run_id, action_id, dimension
-- Units: began_us microseconds of run time, when the first overlap begins; seq position in the run of the claim that
--   begins it, claim_seqs those of all claims that overlap
-- NULL: never; claimants are all who hold one of them
-- Example: fsar-ledger query facts/conflicting_claims LEDGER
WITH pairs AS (
    SELECT
        one.run_id, one.action_id, one.dimension,
        unnest([one.seq, other.seq]) AS seq,
        unnest([one.claimant, other.claimant]) AS claimant,
        unnest([one.began_us, other.began_us]) AS began_us
    FROM held_claims AS one
    INNER JOIN held_claims AS other
        ON
            one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension
            AND one.claimant < other.claimant
            AND one.began_us < other.ended_us AND one.ended_us > other.began_us
)

SELECT
    conflicts.run_id, conflicts.action_id, conflicts.dimension, conflicts.began_us,
    max(pairs.seq) FILTER (pairs.began_us = conflicts.began_us) AS seq,
    list(DISTINCT pairs.seq ORDER BY pairs.seq) AS claim_seqs,
    list(DISTINCT pairs.claimant ORDER BY pairs.claimant) AS claimants
FROM conflicts
INNER JOIN pairs
    ON
        conflicts.run_id = pairs.run_id AND conflicts.action_id = pairs.action_id
        AND conflicts.dimension = pairs.dimension
GROUP BY conflicts.run_id, conflicts.action_id, conflicts.dimension, conflicts.began_us
