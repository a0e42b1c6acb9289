-- Title: Executions of capabilities by robots
-- Paper: sec:model:request (phase 5)
-- Grain: one row per ExecutionStarted event; an action that is executed again has another row
-- Key: run_id, seq
-- Units: started_us, planned_end_us microseconds of run time
-- NULL: task_id, action_id, planned_end_us where the record gives none; robot and on_behalf_of are physical facts, not
--   recorded principals
-- Example: fsar-ledger query facts/executions LEDGER
SELECT
    run_id, seq, task_id, action_id, robot, on_behalf_of, capability,
    time_us AS started_us,
    ends_us AS planned_end_us
FROM execution_started
