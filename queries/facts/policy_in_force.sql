-- Title: The policy in force by robot, scope, capability and context, from each time it may have changed
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot, scope, capability, context and moment at which a window or rule about them begins or
--   ends, except windows without an end in a run that does not record when windows close; before the first, policy
--   allows
-- Key: run_id, robot, scope, capability?, context?, since_us
-- Units: since_us, until_us microseconds of run time, half-open
-- NULL: capability, context for a window or rule about all of them; until_us for the last row of a robot, scope,
--   capability and context
-- Example: fsar-ledger query facts/policy_in_force LEDGER
WITH edges AS (
    SELECT
        windows.run_id, windows.robot, windows.scope, windows.capability, windows.context,
        windows.opened_us AS since_us,
        (windows.outcome = 'deny')::INTEGER AS denies,
        (windows.outcome = 'review')::INTEGER AS reviews
    FROM policy_windows AS windows
    INNER JOIN run_started AS runs ON windows.run_id = runs.run_id
    -- Where a run does not record when windows close, how long one held is unknown.
    WHERE
        windows.window_name IS NULL OR windows.closed_us IS NOT NULL
        OR list_contains(runs.observes, 'policy') OR list_contains(runs.records, 'PolicyWindowClosed')
    UNION ALL
    SELECT
        run_id, robot, scope, capability, context,
        closed_us AS since_us,
        -(outcome = 'deny')::INTEGER AS denies,
        -(outcome = 'review')::INTEGER AS reviews
    FROM policy_windows
    WHERE closed_us IS NOT NULL
),

moments AS (
    SELECT
        run_id, robot, scope, capability, context, since_us,
        sum(denies) AS denies,
        sum(reviews) AS reviews
    FROM edges
    GROUP BY run_id, robot, scope, capability, context, since_us
),

open_windows AS (
    SELECT
        run_id, robot, scope, capability, context, since_us,
        lead(since_us) OVER subject AS until_us,
        sum(denies) OVER subject AS denies,
        sum(reviews) OVER subject AS reviews
    FROM moments
    WINDOW subject AS (PARTITION BY run_id, robot, scope, capability, context ORDER BY since_us)
)

SELECT
    run_id, robot, scope, capability, context, since_us, until_us,
    CASE WHEN denies > 0 THEN 'deny' WHEN reviews > 0 THEN 'review' ELSE 'allow' END AS outcome
FROM open_windows
