-- Title: The policy that was truly in force at a time
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot, scope (its own policy, the fleet's for it), and capability and context that have a
--   rule of their own in that run, with one for all others; or for the capability and context that are asked about
-- Key: run_id, robot, scope, capability?, context?
-- Units: since_us, until_us microseconds of run time, half-open: from and until when the outcome is this one, whichever
--   windows and rules give it; at seconds, by default after the end of every run
-- NULL: capability, context for all that have no row of their own; outcome when nothing on record asks for review or
--   denies and the run does not observe policy; since_us when the outcome is so since the beginning of the run, or
--   unknown; until_us when it did not change later
-- Example: fsar-ledger query audit/policy_at LEDGER --param run=RUN --param robot=robot/D1 --param at=31.2
--   answers robot/D1: its own policy denies since 24.818 s, the fleet's rule since 31.07 s
-- Parameters: run: run = all, robot: robot = all, capability: capability = all, context: context = all, at: time = end
WITH policies AS (
    SELECT
        run_id, robot, scope, capability, context, since_us, until_us,
        CASE outcome WHEN 'deny' THEN 3 WHEN 'review' THEN 2 ELSE 1 END AS strictness
    FROM policy_in_force
    WHERE
        $run IN ('all', run_id) AND $robot IN ('all', robot)
        AND (capability IS NULL OR $capability IN ('all', capability))
        AND (context IS NULL OR $context IN ('all', context))
),

capabilities AS (
    SELECT DISTINCT run_id, robot, scope, capability
    FROM policies
    WHERE capability IS NOT NULL AND $capability = 'all'
),

contexts AS (
    SELECT DISTINCT run_id, robot, scope, context
    FROM policies
    WHERE context IS NOT NULL AND $context = 'all'
),

members AS (
    SELECT
        members.run_id, members.robot, scopes.scope,
        nullif($capability, 'all') AS capability,
        nullif($context, 'all') AS context
    FROM fleet_members AS members
    CROSS JOIN (VALUES ('local'), ('fleet')) AS scopes (scope)
    WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot)
),

of_capabilities AS (
    SELECT run_id, robot, scope, capability, context
    FROM members
    UNION ALL
    SELECT members.run_id, members.robot, members.scope, capabilities.capability, members.context
    FROM members
    INNER JOIN capabilities
        ON
            members.run_id = capabilities.run_id AND members.robot = capabilities.robot
            AND members.scope = capabilities.scope
),

every AS (
    SELECT run_id, robot, scope, capability, context
    FROM of_capabilities
    UNION ALL
    SELECT asked.run_id, asked.robot, asked.scope, asked.capability, contexts.context
    FROM of_capabilities AS asked
    INNER JOIN contexts
        ON asked.run_id = contexts.run_id AND asked.robot = contexts.robot AND asked.scope = contexts.scope
),

subjects AS (
    SELECT
        row_number() OVER () AS subject,
        every.run_id, every.robot, every.scope, every.capability, every.context,
        coalesce(list_contains(runs.observes, 'policy'), FALSE) AS is_observed
    FROM every
    INNER JOIN runs ON every.run_id = runs.run_id
),

applicable AS (
    -- The strictest holds of what is in force for all capabilities and contexts, and of what is about these.
    SELECT subjects.subject, policies.since_us, policies.until_us, policies.strictness
    FROM subjects
    INNER JOIN policies
        ON
            subjects.run_id = policies.run_id AND subjects.robot = policies.robot AND subjects.scope = policies.scope
            AND (policies.capability IS NULL OR subjects.capability = policies.capability)
            AND (policies.context IS NULL OR subjects.context = policies.context)
),

standing AS (
    SELECT
        begun.subject, begun.since_us,
        max(policy.strictness) AS strictness
    FROM (SELECT DISTINCT subject, since_us FROM applicable) AS begun
    INNER JOIN applicable AS policy
        ON
            begun.subject = policy.subject AND begun.since_us >= policy.since_us
            AND (policy.until_us IS NULL OR begun.since_us < policy.until_us)
    GROUP BY begun.subject, begun.since_us
),

changes AS (
    SELECT subject, since_us, strictness
    FROM standing
    QUALIFY strictness <> lag(strictness, 1, 1) OVER (PARTITION BY subject ORDER BY since_us)
),

moments AS (
    SELECT
        subject,
        max(since_us) FILTER (WHERE since_us <= $at_us::BIGINT) AS since_us,
        min(since_us) FILTER (WHERE since_us > $at_us::BIGINT) AS until_us,
        coalesce(arg_max(strictness, since_us) FILTER (WHERE since_us <= $at_us::BIGINT), 1) AS strictness
    FROM changes
    GROUP BY subject
)

-- A run that does not observe policy can show that something was not allowed, and never that it was.
SELECT
    subjects.run_id, subjects.robot, subjects.scope, subjects.capability, subjects.context,
    if(
        subjects.is_observed OR moments.strictness > 1,
        list_extract(['allow', 'review', 'deny'], coalesce(moments.strictness, 1)),
        NULL
    ) AS outcome,
    if(subjects.is_observed OR moments.strictness > 1, moments.since_us, NULL) AS since_us,
    moments.until_us
FROM subjects
LEFT JOIN moments ON subjects.subject = moments.subject
