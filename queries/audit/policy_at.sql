-- Title: The policy that was truly in force at a time
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot and scope (its own policy, the fleet's for it)
-- Key: run_id, robot, scope
-- Units: since_us, until_us microseconds of run time, half-open; at seconds, by default after the end of every run
-- NULL: since_us when nothing had begun yet, so policy allowed from the start; until_us when no window or rule began or
--   ended later
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
    WHERE (capability IS NULL OR capability = $capability) AND (context IS NULL OR context = $context)
),

moments AS (
    SELECT
        subjects.run_id, subjects.robot, subjects.scope,
        max(policy.since_us) FILTER (WHERE policy.since_us <= $at_us::BIGINT) AS since_us,
        min(policy.since_us) FILTER (WHERE policy.since_us > $at_us::BIGINT) AS until_us,
        max(policy.strictness) FILTER (
            WHERE policy.since_us <= $at_us::BIGINT AND (policy.until_us IS NULL OR policy.until_us > $at_us::BIGINT)
        ) AS strictness
    FROM subjects
    LEFT JOIN applicable AS policy
        ON subjects.run_id = policy.run_id AND subjects.robot = policy.robot AND subjects.scope = policy.scope
    GROUP BY subjects.run_id, subjects.robot, subjects.scope
)

SELECT
    run_id, robot, scope,
    list_extract(['allow', 'review', 'deny'], coalesce(strictness, 1)) AS outcome,
    since_us, until_us
FROM moments
