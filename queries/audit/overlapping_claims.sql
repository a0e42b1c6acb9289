-- Title: Pairs of overlapping claims: two principals that held the same dimension of authority over one action
-- Paper: eq:auth, sec:evaluation:metrics (authority conflicts)
-- Grain: one row per pair of claims that overlap; claims end just before their release
-- Key: run_id, one_seq, other_seq
-- Units: from_us, until_us microseconds of run time, half-open
-- NULL: until_us when neither claim was released
-- Example: fsar-ledger query audit/overlapping_claims LEDGER --param run=RUN
--   answers A1-1/7.1, override: robot/A1 (revocation) and robot/D1 (acceptance) from 51.375 s until 58.486 s
-- Parameters: run: run = all, action: action = all
SELECT
    one.run_id, one.action_id, one.dimension,
    one.claimant AS one_claimant,
    one.reason AS one_reason,
    one.seq AS one_seq,
    other.claimant AS other_claimant,
    other.reason AS other_reason,
    other.seq AS other_seq,
    greatest(one.began_us, other.began_us) AS from_us,
    least(one.ended_us, other.ended_us) AS until_us
FROM claims AS one
INNER JOIN claims AS other
    ON
        one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension
        AND one.claimant < other.claimant
WHERE
    $run IN ('all', one.run_id)
    AND $action IN ('all', one.action_id)
    -- A claim that ends when it begins was never held.
    AND (one.ended_us IS NULL OR one.ended_us > greatest(one.began_us, other.began_us))
    AND (other.ended_us IS NULL OR other.ended_us > greatest(one.began_us, other.began_us))
