-- Title: Overlaps of claims: two principals that hold the same dimension of authority over one action at once
-- Paper: eq:auth, sec:evaluation:metrics (authority conflict)
-- Grain: one row per pair of claims (held_claims) of two principals that overlap
-- Key: run_id, one_seq, other_seq
-- Units: one_began_us, other_began_us, from_us, until_us microseconds of run time, half-open; until_us
--   9223372036854775807 when neither claim was released
-- NULL: never
-- Example: fsar-ledger query facts/claim_overlaps LEDGER
-- The first overlap of each action and dimension is in conflicts, which finds it without comparing every pair.
SELECT
    one.run_id, one.action_id, one.dimension,
    one.seq AS one_seq,
    one.claimant AS one_claimant,
    one.began_us AS one_began_us,
    other.seq AS other_seq,
    other.claimant AS other_claimant,
    other.began_us AS other_began_us,
    greatest(one.began_us, other.began_us) AS from_us,
    least(one.ended_us, other.ended_us) AS until_us
FROM held_claims AS one
INNER JOIN held_claims AS other
    ON
        one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension
        AND one.claimant < other.claimant AND one.began_us < other.ended_us AND one.ended_us > other.began_us
