-- Title: Calls to the fleet supervisor, each an intervention
-- Paper: sec:evaluation:metrics (human intervention), eq:supervision
-- Grain: one row per SupervisorCalled event for H_F
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when the call is about no action
-- Example: fsar-ledger query facts/fleet_calls LEDGER
SELECT run_id, seq, time_us, action_id, supervisor, purpose
FROM supervisor_called
WHERE supervisor = 'supervisor/fleet'
