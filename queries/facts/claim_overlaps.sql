-- Title: Overlapping claims: two principals that hold the same dimension of authority over one action at once
-- Paper: eq:auth, sec:evaluation:metrics (authority conflicts)
-- Grain: one row per pair of claims (held_claims) that overlap
-- Key: run_id, one_seq, other_seq
-- Units: from_us, until_us microseconds of run time, half-open; later_seq the later claim of the two
-- NULL: until_us when neither claim was released
-- Example: fsar-ledger query facts/claim_overlaps LEDGER
SELECT
    one.run_id, one.action_id, one.dimension,
    one.claimant AS one_claimant,
    one.seq AS one_seq,
    other.claimant AS other_claimant,
    other.seq AS other_seq,
    if((one.began_us, one.seq) > (other.began_us, other.seq), one.seq, other.seq) AS later_seq,
    greatest(one.began_us, other.began_us) AS from_us,
    nullif(least(one.ended_us, other.ended_us), 9223372036854775807) AS until_us
FROM held_claims AS one
INNER JOIN held_claims AS other
    ON
        one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension
        AND one.claimant < other.claimant
        AND one.began_us < other.ended_us AND one.ended_us > other.began_us
