-- Title: A run succeeds if all its tasks do
-- Paper: sec:evaluation:scenarios
-- Reading: R3
-- Question: what counts as a fleet task
-- Replaces: coordination_success
-- Moves: coordination_success
-- Why: Each scenario but the last is told as one task of the fleet (a heavy delivery task, a secure inspection task),
--   which robots and steps share.
-- Grain: one row per run
-- Key: run_id
-- Units: as in coordination_success
-- NULL: as in coordination_success
-- Example: fsar-ledger query readings/whole_runs_succeed LEDGER
SELECT
    run_id,
    (denominator > 0 AND numerator = denominator)::BIGINT AS numerator,
    (denominator > 0)::BIGINT AS denominator,
    CASE WHEN denominator > 0 THEN (numerator = denominator)::DOUBLE END AS value,
    not_observed
FROM coordination_success
