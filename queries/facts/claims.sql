-- Title: Claims of authority and the intervals in which they hold
-- Paper: eq:auth
-- Grain: one row per AuthorityClaimed event
-- Key: run_id, seq
-- Units: began_us, ended_us microseconds of run time, half-open: a claim no longer holds at ended_us
-- NULL: ended_us when the claim was never released and its claimant has not departed; task_id when it is about no task
-- Example: fsar-ledger query facts/claims LEDGER
WITH edges AS (
    SELECT run_id, seq, time_us, type, task_id, action_id, dimension, claimant, reason
    FROM authority_events
    WHERE type IN ('AuthorityClaimed.v1', 'AuthorityReleased.v1')
),

paired AS (
    SELECT
        run_id, seq, time_us, type, task_id, action_id, dimension, claimant, reason,
        -- The first later release, regardless of claims in between: a repeated claim ends with the one before it.
        first_value(CASE WHEN type = 'AuthorityReleased.v1' THEN time_us END IGNORE NULLS) OVER (
            PARTITION BY run_id, action_id, dimension, claimant, reason
            ORDER BY seq
            ROWS BETWEEN 1 FOLLOWING AND UNBOUNDED FOLLOWING
        ) AS ended_us
    FROM edges
)

SELECT
    paired.run_id, paired.seq, paired.task_id, paired.action_id, paired.dimension, paired.claimant, paired.reason,
    paired.time_us AS began_us,
    least(paired.ended_us, departed.time_us) AS ended_us
FROM paired
-- A robot that leaves the fleet gives up its claims, even where no release is on record.
ASOF LEFT JOIN robot_departed AS departed
    ON paired.run_id = departed.run_id AND paired.claimant = departed.robot AND paired.seq < departed.seq
WHERE paired.type = 'AuthorityClaimed.v1'
