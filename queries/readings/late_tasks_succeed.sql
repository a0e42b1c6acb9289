-- Title: A task that is completed at all succeeds
-- Paper: sec:evaluation:metrics
-- Reading: R3
-- Question: how much time a task has
-- Replaces: task_arrived
-- Moves: coordination_success, success_without_violation
-- Why: The allotted time is printed nowhere; a task that we call late is still worked on, and given up after twice its
--   budget, so that may be the allotted time.
-- Grain: one row per TaskArrived event
-- Key: run_id, seq
-- Units: as in task_arrived
-- NULL: as in task_arrived
-- Example: fsar-ledger query readings/late_tasks_succeed LEDGER
SELECT * REPLACE (9223372036854775807 AS budget_us)
FROM task_arrived
