-- Title: Failures, how each was resolved and when recovery left its first level
-- Paper: sec:model:recovery
-- Grain: one row per ExecutionFailed event: one per run, action and number of the failure, unless it is told twice
-- Key: run_id, seq
-- Units: detected_us, resolved_us, left_us microseconds of run time; latency_us microseconds, 0 when recovery leaves
--   its first level at once
-- NULL: resolved_level, resolved_us when never resolved; left_us when the first level was never left; latency_us when
--   neither occurred; is_contained when never resolved and the run does not observe recovery
-- Example: fsar-ledger query facts/failures LEDGER
-- Stored: containment and latency both read it
WITH resolutions AS (
    SELECT
        run_id, action_id, failure,
        min(time_us) AS resolved_us,
        arg_min(level, seq) AS resolved_level
    FROM failure_resolved
    GROUP BY run_id, action_id, failure
),

departures AS (
    SELECT
        run_id,
        failed_action AS action_id,
        failure,
        min(time_us) AS left_us
    FROM recovery_events
    WHERE type IN ('RecoveryEscalated.v1', 'AssistanceRequested.v1')
    GROUP BY run_id, failed_action, failure
)

SELECT
    detected.run_id, detected.seq, detected.task_id, detected.action_id, detected.failure, detected.robot,
    detected.cause,
    detected.time_us AS detected_us,
    resolutions.resolved_us, resolutions.resolved_level, departures.left_us,
    coalesce(
        resolutions.resolved_level IN ('local', 'peer'), if(list_contains(runs.observes, 'recovery'), FALSE, NULL)
    ) AS is_contained,
    -- Every reaction advances the clock by a microsecond (R25): a level left at once was left at the detection.
    CASE
        WHEN resolutions.resolved_level = 'local' THEN resolutions.resolved_us
        WHEN departures.left_us = detected.time_us + 1 THEN detected.time_us
        ELSE departures.left_us
    END - detected.time_us AS latency_us
FROM execution_failed AS detected
INNER JOIN runs ON detected.run_id = runs.run_id
LEFT JOIN resolutions
    ON
        detected.run_id = resolutions.run_id AND detected.action_id = resolutions.action_id
        AND detected.failure = resolutions.failure
LEFT JOIN departures
    ON
        detected.run_id = departures.run_id AND detected.action_id = departures.action_id
        AND detected.failure = departures.failure
