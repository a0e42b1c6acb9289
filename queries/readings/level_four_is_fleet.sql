-- Title: A failure that reaches a robot's own supervisor is an intervention, too
-- Paper: sec:model:recovery
-- Reading: R9
-- Question: whom the last level of recovery calls
-- Replaces: fleet_calls
-- Moves: human_intervention
-- Why: The last level is directed to local or fleet supervision depending on scope, and scope is not defined; it may be
--   the fleet supervisor always.
-- Grain: one row per call
-- Key: run_id, seq
-- Units: as in fleet_calls
-- NULL: as in fleet_calls
-- Example: fsar-ledger query readings/level_four_is_fleet LEDGER
SELECT *
FROM fleet_calls
UNION ALL BY NAME
SELECT run_id, seq, time_us, action_id, supervisor, purpose
FROM supervisor_called
WHERE purpose = 'recovery' AND supervisor <> 'supervisor/fleet'
