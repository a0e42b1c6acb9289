-- Title: Pairs of overlapping claims: two principals that held the same dimension of authority over one action
-- Paper: eq:auth, sec:evaluation:metrics (authority conflicts)
-- Grain: one row per pair of claims that overlap; a claim no longer holds at the time of its release
-- Key: run_id, one_seq, other_seq
-- Units: from_us, until_us microseconds of run time, half-open
-- NULL: until_us when neither claim was released; no row where the run does not record releases, as nothing tells then
--   whether a claim still held
-- Example: fsar-ledger query audit/overlapping_claims LEDGER --param run=RUN
--   answers A1-1/7.1, override: robot/A1 (revocation) and robot/D1 (acceptance) from 51.375 s until 58.486 s
-- Parameters: run: run = all, action: action = all
SELECT
    pairs.run_id, pairs.action_id, pairs.dimension, pairs.one_claimant,
    one.reason AS one_reason,
    pairs.one_seq, pairs.other_claimant,
    other.reason AS other_reason,
    pairs.other_seq, pairs.from_us, pairs.until_us
FROM claim_overlaps AS pairs
SEMI JOIN run_started AS runs
    ON
        pairs.run_id = runs.run_id
        AND list_has_any(list_cat(runs.observes, runs.records), ['authority', 'AuthorityReleased'])
INNER JOIN claims AS one ON pairs.run_id = one.run_id AND pairs.one_seq = one.seq
INNER JOIN claims AS other ON pairs.run_id = other.run_id AND pairs.other_seq = other.seq
WHERE $run IN ('all', pairs.run_id) AND $action IN ('all', pairs.action_id)
