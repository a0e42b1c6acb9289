-- Title: A failure resolved by a retry that another principal than the robot orders is resolved at fleet level
-- Paper: sec:evaluation:baselines
-- Reading: R5
-- Question: the level of an ordered retry
-- Replaces: failures
-- Moves: recovery_containment, reassignment_latency_s
-- Why: The first level is the robot's own runtime, and under CFC every failure is at once escalated to the coordinator,
--   in 100 % of runs.
-- Grain: one row per failure
-- Key: run_id, seq
-- Units: as in failures
-- NULL: as in failures
-- Example: fsar-ledger query readings/ordered_retry_is_fleet LEDGER
WITH ordered AS (
    SELECT
        run_id,
        failed_action AS action_id,
        failure,
        min(time_us) AS ordered_us
    FROM recovery_attempted
    WHERE decided_by <> robot AND NOT starts_with(decided_by, replace(robot, 'robot/', 'agent/') || '/')
    GROUP BY run_id, failed_action, failure
)

SELECT
    failures.* REPLACE (
        CASE WHEN ordered.ordered_us IS NULL THEN failures.resolved_level ELSE 'fleet' END AS resolved_level,
        coalesce(ordered.ordered_us, failures.left_us) AS left_us,
        failures.is_contained AND ordered.ordered_us IS NULL AS is_contained,
        coalesce(ordered.ordered_us - failures.detected_us, failures.latency_us) AS latency_us
    )
FROM failures
LEFT JOIN ordered
    ON
        failures.run_id = ordered.run_id AND failures.action_id = ordered.action_id
        AND failures.failure = ordered.failure AND failures.resolved_level = 'local'
