-- Title: Every case that one of the paper's eight metrics counts, with its time
-- Paper: sec:evaluation:metrics
-- Grain: one row per task, decision, failure (of recovery containment, and of reassignment latency), conflict of
--   authority, governed start, call of the fleet supervisor, and coordination record
-- Key: none, several cases of one metric may be at one moment
-- Units: time_us microseconds of run time: of the arrival, the detection or the beginning; numerator, denominator what
--   it adds to those of its metric, microseconds for the latency; denominator 0 for metrics that are counts
-- NULL: numerator of a case for which the run does not show whether it counts
-- Example: fsar-ledger query facts/metric_cases LEDGER
WITH completed AS (
    SELECT DISTINCT run_id, task_id FROM task_completed
)

SELECT
    arrived.run_id, 'coordination_success' AS metric, arrived.time_us,
    CASE WHEN late.run_id IS NOT NULL THEN 0 WHEN done.run_id IS NOT NULL THEN 1 END::BIGINT AS numerator,
    1::BIGINT AS denominator
FROM task_arrived AS arrived
LEFT JOIN late_tasks AS late ON arrived.run_id = late.run_id AND arrived.seq = late.arrived_seq
LEFT JOIN completed AS done
    ON arrived.run_id = done.run_id AND arrived.task_id = done.task_id AND arrived.budget_us IS NOT NULL
UNION ALL
SELECT run_id, 'governance_locality' AS metric, time_us, is_local::BIGINT AS numerator, 1 AS denominator
FROM decisions
UNION ALL
SELECT run_id, 'recovery_containment' AS metric, detected_us, is_contained::BIGINT AS numerator, 1 AS denominator
FROM failures
UNION ALL
SELECT run_id, 'authority_conflicts' AS metric, began_us, 1 AS numerator, 0 AS denominator
FROM conflicts
UNION ALL
SELECT run_id, 'policy_violations' AS metric, started_us, is_violation::BIGINT AS numerator, 0 AS denominator
FROM governed_starts
UNION ALL
SELECT run_id, 'reassignment_latency_s' AS metric, detected_us, latency_us AS numerator, 1 AS denominator
FROM failures
WHERE latency_us IS NOT NULL
UNION ALL
SELECT run_id, 'human_intervention' AS metric, time_us, 1 AS numerator, 0 AS denominator
FROM fleet_calls
UNION ALL
SELECT run_id, 'audit_attributability' AS metric, time_us, is_attributable::BIGINT AS numerator, 1 AS denominator
FROM coordination_events
