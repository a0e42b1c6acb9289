-- Title: A start without the approval that a review asks for violates nothing
-- Paper: sec:model:invariants (I3)
-- Reading: R7
-- Question: what fails a check
-- Replaces: governed_starts
-- Moves: policy_violations
-- Why: Invariant I3 demands that the composed policy does not deny; a review is another of its three outcomes.
-- Grain: one row per execution or motion that policy governs
-- Key: run_id, seq
-- Units: as in governed_starts
-- NULL: as in governed_starts
-- Example: fsar-ledger query readings/review_is_no_denial LEDGER
SELECT * REPLACE (is_violation AND outcome = 'deny' AS is_violation)
FROM governed_starts
