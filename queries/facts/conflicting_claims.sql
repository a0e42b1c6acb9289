-- Title: The claims in each authority conflict, held at once by distinct principals
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per conflict (conflicts)
-- Key: run_id, action_id, dimension
-- Units: began_us microseconds of run time, when the first overlap begins; seq position in the run of the claim that
--   begins it, claim_seqs those of all overlapping claims
-- NULL: never; claimants are all principals that hold one of them
-- Example: fsar-ledger query facts/conflicting_claims LEDGER
WITH pairs AS (
    SELECT
        run_id, action_id, dimension, from_us, later_seq,
        unnest([one_seq, other_seq]) AS seq,
        unnest([one_claimant, other_claimant]) AS claimant
    FROM claim_overlaps
)

SELECT
    conflicts.run_id, conflicts.action_id, conflicts.dimension, conflicts.began_us,
    min(pairs.later_seq) FILTER (pairs.from_us = conflicts.began_us) AS seq,
    list(DISTINCT pairs.seq ORDER BY pairs.seq) AS claim_seqs,
    list(DISTINCT pairs.claimant ORDER BY pairs.claimant) AS claimants
FROM conflicts
INNER JOIN pairs
    ON
        conflicts.run_id = pairs.run_id AND conflicts.action_id = pairs.action_id
        AND conflicts.dimension = pairs.dimension
GROUP BY conflicts.run_id, conflicts.action_id, conflicts.dimension, conflicts.began_us
