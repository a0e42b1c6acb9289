-- Title: Routine motions are not governed
-- Paper: sec:evaluation:metrics
-- Reading: R42
-- Question: what counts as an action
-- Replaces: governed_starts
-- Moves: policy_violations
-- Why: Actions that proceed despite a check: a motion that serves no request is no action on which anybody checks.
-- Grain: one row per execution or motion that policy governs
-- Key: run_id, seq
-- Units: as in governed_starts
-- NULL: as in governed_starts
-- Example: fsar-ledger query readings/motions_are_no_actions LEDGER
SELECT *
FROM governed_starts
WHERE action_id IS NOT NULL
