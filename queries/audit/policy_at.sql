-- Title: The policy that was truly in force at a time
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot and scope (its own policy, the fleet's for it)
-- Key: run_id, robot, scope
-- Units: since_us, until_us microseconds of run time, half-open: from and until when the outcome is this one, whichever
--   windows and rules give it; at seconds, by default after the end of every run
-- NULL: since_us when policy allows and always did; until_us when the outcome did not change later
-- Example: fsar-ledger query audit/policy_at LEDGER --param run=RUN --param robot=robot/D1 --param at=31.2
--   answers robot/D1: its own policy denies since 24.818 s, the fleet's rule since 31.07 s
-- Parameters: run: run = all, robot: robot = all, capability: capability = any, context: context = any, at: time = end
WITH subjects AS (
    SELECT members.run_id, members.robot, scopes.scope
    FROM fleet_members AS members
    CROSS JOIN (VALUES ('local'), ('fleet')) AS scopes (scope)
    WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot)
),

applicable AS (
    -- Without a capability or context, only what is in force for all of them; with one, the strictest of that and of
    -- what is about it.
    SELECT
        run_id, robot, scope, since_us, until_us,
        CASE outcome WHEN 'deny' THEN 3 WHEN 'review' THEN 2 ELSE 1 END AS strictness
    FROM policy_in_force
    WHERE
        $run IN ('all', run_id) AND $robot IN ('all', robot)
        AND (capability IS NULL OR capability = $capability) AND (context IS NULL OR context = $context)
),

standing AS (
    SELECT
        begun.run_id, begun.robot, begun.scope, begun.since_us,
        max(policy.strictness) AS strictness
    FROM (SELECT DISTINCT run_id, robot, scope, since_us FROM applicable) AS begun
    INNER JOIN applicable AS policy
        ON
            begun.run_id = policy.run_id AND begun.robot = policy.robot AND begun.scope = policy.scope
            AND begun.since_us >= policy.since_us
            AND (policy.until_us IS NULL OR begun.since_us < policy.until_us)
    GROUP BY begun.run_id, begun.robot, begun.scope, begun.since_us
),

changes AS (
    SELECT run_id, robot, scope, since_us, strictness
    FROM standing
    QUALIFY strictness <> coalesce(lag(strictness) OVER (PARTITION BY run_id, robot, scope ORDER BY since_us), 1)
),

moments AS (
    SELECT
        subjects.run_id, subjects.robot, subjects.scope,
        max(changes.since_us) FILTER (WHERE changes.since_us <= $at_us::BIGINT) AS since_us,
        min(changes.since_us) FILTER (WHERE changes.since_us > $at_us::BIGINT) AS until_us,
        arg_max(changes.strictness, changes.since_us) FILTER (WHERE changes.since_us <= $at_us::BIGINT) AS strictness
    FROM subjects
    LEFT JOIN changes
        ON subjects.run_id = changes.run_id AND subjects.robot = changes.robot AND subjects.scope = changes.scope
    GROUP BY subjects.run_id, subjects.robot, subjects.scope
)

SELECT
    run_id, robot, scope,
    list_extract(['allow', 'review', 'deny'], coalesce(strictness, 1)) AS outcome,
    since_us, until_us
FROM moments
