-- Title: Each claim made while another principal holds the dimension is a conflict
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: what counts as one conflict
-- Replaces: conflicts
-- Moves: authority_conflicts
-- Why: The number of events: each claim is one, and a principal that claims again, claims against the other again.
-- Grain: one row per claim that begins while another principal holds the same dimension of the action
-- Key: none, each row is a claim
-- Units: as in conflicts
-- NULL: as in conflicts
-- Example: fsar-ledger query readings/conflict_of_claim LEDGER
SELECT
    run_id, action_id, dimension,
    from_us AS began_us
FROM claim_overlaps
GROUP BY run_id, action_id, dimension, later_seq, from_us
