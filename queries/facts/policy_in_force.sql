-- Title: The policy in force, from each moment at which it may have changed
-- Paper: eq:policy
-- Grain: one row per run, robot, scope and moment at which a window opens or closes; before the first, policy allows
-- Units: since_us, until_us microseconds of run time, half-open
-- NULL: until_us for the last row of a robot and scope
-- Example: fsar-ledger query facts/policy_in_force LEDGER
WITH edges AS (
    SELECT
        run_id,
        robot,
        scope,
        opened_us AS since_us,
        (outcome = 'deny')::INTEGER AS denies,
        (outcome = 'review')::INTEGER AS reviews
    FROM policy_windows
    UNION ALL
    SELECT
        run_id,
        robot,
        scope,
        closed_us AS since_us,
        -(outcome = 'deny')::INTEGER AS denies,
        -(outcome = 'review')::INTEGER AS reviews
    FROM policy_windows
    WHERE closed_us IS NOT NULL
),

moments AS (
    SELECT
        run_id,
        robot,
        scope,
        since_us,
        sum(denies) AS denies,
        sum(reviews) AS reviews
    FROM edges
    GROUP BY run_id, robot, scope, since_us
),

open_windows AS (
    SELECT
        run_id,
        robot,
        scope,
        since_us,
        lead(since_us) OVER robot_scope AS until_us,
        sum(denies) OVER robot_scope AS denies,
        sum(reviews) OVER robot_scope AS reviews
    FROM moments
    WINDOW robot_scope AS (PARTITION BY run_id, robot, scope ORDER BY since_us)
)

SELECT
    run_id,
    robot,
    scope,
    since_us,
    until_us,
    CASE WHEN denies > 0 THEN 'deny' WHEN reviews > 0 THEN 'review' ELSE 'allow' END AS outcome
FROM open_windows
