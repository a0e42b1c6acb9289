-- Title: Where another robot resolves the failure, the latency lasts until then
-- Paper: sec:evaluation:metrics
-- Reading: R5
-- Question: what ends the latency
-- Replaces: failures
-- Moves: reassignment_latency_s
-- Why: A reassignment is successful when the other robot has done it, not when recovery turns to the next level.
-- Grain: one row per failure
-- Key: run_id, seq
-- Units: as in failures
-- NULL: as in failures
-- Example: fsar-ledger query readings/latency_until_helped LEDGER
WITH helped AS (
    SELECT
        run_id, action_id, failure,
        min(time_us) AS helped_us
    FROM failure_resolved
    WHERE level IN ('peer', 'fleet')
    GROUP BY run_id, action_id, failure
)

SELECT failures.* REPLACE (coalesce(helped.helped_us - failures.detected_us, failures.latency_us) AS latency_us)
FROM failures
LEFT JOIN helped
    ON failures.run_id = helped.run_id AND failures.action_id = helped.action_id AND failures.failure = helped.failure
