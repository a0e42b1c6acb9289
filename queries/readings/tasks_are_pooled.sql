-- Title: Success is the share of all tasks, not the mean share of runs
-- Paper: sec:evaluation:metrics
-- Reading: R3
-- Question: how tasks of several runs are combined
-- Replaces: metric_definitions
-- Moves: coordination_success
-- Why: A fraction of fleet tasks; averaged across runs is said of other metrics, and not of this one.
-- Grain: one row per metric
-- Key: metric
-- Units: as in metric_definitions
-- NULL: as in metric_definitions
-- Example: fsar-ledger query readings/tasks_are_pooled LEDGER
SELECT * REPLACE (is_pooled OR metric = 'coordination_success' AS is_pooled)
FROM metric_definitions
