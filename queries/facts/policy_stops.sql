-- Title: Actions that policy stops: refused requests, and admitted actions held under the executor's own denial
-- Paper: eq:policy, sec:architecture:fleet
-- Grain: one row per RequestDenied event for reasons of policy, and per ExecutionHeld event whose outcome is the
--   executor's own denial
-- Key: run_id, seq
-- Units: time_us microseconds of run time; seq, previous_seq positions in the run, previous_seq of the action's stop
--   before this one (-1: none)
-- NULL: task_id where the record names no task
-- Example: fsar-ledger query facts/policy_stops LEDGER
WITH stops AS (
    SELECT
        denied.run_id, denied.seq, denied.time_us, denied.task_id, denied.action_id,
        denied.executed_by AS robot,
        issued.capability
    FROM request_denied AS denied
    ASOF JOIN request_issued AS issued
        ON denied.run_id = issued.run_id AND denied.action_id = issued.action_id AND denied.seq > issued.seq
    -- In DuckDB versions before ours, which may read this in a file, ASOF joins NULL to NULL.
    WHERE denied.reason = 'policy' AND denied.action_id IS NOT NULL
    UNION ALL
    SELECT held.run_id, held.seq, held.time_us, held.task_id, held.action_id, held.robot, queued.capability
    FROM execution_held AS held
    ASOF JOIN execution_queued AS queued
        ON held.run_id = queued.run_id AND held.action_id = queued.action_id AND held.seq > queued.seq
    WHERE held.reason = 'local-policy' AND held.outcome = 'deny'
)

SELECT
    run_id, seq, time_us, task_id, action_id, robot, capability,
    coalesce(lag(seq) OVER (PARTITION BY run_id, action_id ORDER BY seq), -1) AS previous_seq
FROM stops
