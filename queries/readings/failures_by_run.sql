-- Title: Containment and latency are means over the runs that had a failure
-- Paper: sec:evaluation:metrics
-- Reading: R5
-- Question: how failures of several runs are combined
-- Replaces: metric_definitions
-- Moves: recovery_containment, reassignment_latency_s
-- Why: The tests pair runs, so each run has a number of its own; other metrics are said to be averaged across runs.
-- Grain: one row per metric
-- Key: metric
-- Units: as in metric_definitions
-- NULL: as in metric_definitions
-- Example: fsar-ledger query readings/failures_by_run LEDGER
SELECT * REPLACE (is_pooled AND metric NOT IN ('recovery_containment', 'reassignment_latency_s') AS is_pooled)
FROM metric_definitions
