-- Title: The policy in force at a time, as it truly was
-- Paper: eq:policy
-- Grain: one row per run, robot and scope (its own policy, the fleet's rule for its zone)
-- Units: since_us, until_us, at_us microseconds of run time, half-open; the default time is after the end of every run
-- NULL: since_us when no window had opened yet, so policy allowed from the start; until_us when no window opened or closed later
-- Example: fsar-ledger query audit/policy_at LEDGER --param run=RUN --param robot=robot/D1 --param at_us=31200000
--   answers robot/D1: its own policy denies since 24.818 s, the fleet's rule since 31.07 s
-- Parameters: run = all, robot = all, at_us = 9007199254740991
WITH subjects AS (
    SELECT
        members.run_id,
        members.robot,
        scopes.scope
    FROM robot_joined AS members
    CROSS JOIN (VALUES ('local'), ('fleet')) AS scopes (scope)
    WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot)
),

moments AS (
    SELECT
        subjects.run_id,
        subjects.robot,
        subjects.scope,
        max(policy.since_us) FILTER (WHERE policy.since_us <= $at_us::BIGINT) AS since_us,
        min(policy.since_us) FILTER (WHERE policy.since_us > $at_us::BIGINT) AS until_us,
        arg_max(policy.outcome, policy.since_us) FILTER (WHERE policy.since_us <= $at_us::BIGINT) AS outcome
    FROM subjects
    LEFT JOIN policy_in_force AS policy
        ON subjects.run_id = policy.run_id AND subjects.robot = policy.robot AND subjects.scope = policy.scope
    GROUP BY subjects.run_id, subjects.robot, subjects.scope
)

SELECT
    run_id,
    robot,
    scope,
    coalesce(outcome, 'allow') AS outcome,
    since_us,
    until_us
FROM moments
