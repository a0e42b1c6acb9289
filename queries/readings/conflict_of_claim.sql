-- Title: Each claim that is made while another principal holds the dimension is a conflict
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: what one conflict is
-- Replaces: conflicts
-- Moves: authority_conflicts
-- Why: The number of events: each claim is one, and a principal that claims again, claims against the other again.
-- Grain: one row per claim that begins while another principal holds the same dimension of the action
-- Key: none, each row is a claim
-- Units: as in conflicts
-- NULL: as in conflicts
-- Example: fsar-ledger query readings/conflict_of_claim LEDGER
SELECT later.run_id, later.action_id, later.dimension, later.began_us
FROM held_claims AS later
SEMI JOIN held_claims AS earlier
    ON
        later.run_id = earlier.run_id AND later.action_id = earlier.action_id AND later.dimension = earlier.dimension
        AND later.claimant <> earlier.claimant AND (earlier.began_us, earlier.seq) < (later.began_us, later.seq)
        AND later.began_us < earlier.ended_us
