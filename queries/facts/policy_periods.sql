-- Title: The strictest policy in force, for each capability and context with a rule of its own and for all others
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot, scope, capability, context and moment from which the outcome differs from the one
--   before; capability and context are those that have a rule of their own, in all combinations, and NULL for all
--   others
-- Key: run_id, robot, scope, capability?, context?, since_us?
-- Units: since_us microseconds of run time; strictness 1 allow, 2 review, 3 deny
-- NULL: capability, context for all others; since_us for the beginning of the run, when policy allows
-- Example: fsar-ledger query facts/policy_periods LEDGER
WITH capabilities AS (
    SELECT run_id, robot, scope, NULL AS capability
    FROM policy_subjects
    UNION
    SELECT run_id, robot, scope, capability
    FROM policy_in_force
),

contexts AS (
    SELECT run_id, robot, scope, NULL AS context
    FROM policy_subjects
    UNION
    SELECT run_id, robot, scope, context
    FROM policy_in_force
),

subjects AS (
    SELECT
        row_number() OVER () AS subject,
        one.run_id, one.robot, one.scope, one.capability, contexts.context
    FROM capabilities AS one
    INNER JOIN contexts ON one.run_id = contexts.run_id AND one.robot = contexts.robot AND one.scope = contexts.scope
),

applicable AS (
    -- The strictest of the outcomes in force for all capabilities and contexts and for these in particular holds.
    SELECT
        subjects.subject, policies.since_us, policies.until_us,
        CASE policies.outcome WHEN 'deny' THEN 3 WHEN 'review' THEN 2 ELSE 1 END AS strictness
    FROM subjects
    INNER JOIN policy_in_force AS policies
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
    UNION ALL
    SELECT subject, NULL AS since_us, 1 AS strictness
    FROM subjects
)

SELECT
    subjects.run_id, subjects.robot, subjects.scope, subjects.capability, subjects.context,
    standing.since_us, standing.strictness
FROM standing
INNER JOIN subjects ON standing.subject = subjects.subject
QUALIFY
    standing.strictness IS DISTINCT FROM lag(standing.strictness) OVER (
        PARTITION BY standing.subject ORDER BY standing.since_us NULLS FIRST
    )
