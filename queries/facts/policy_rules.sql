-- Title: Policy set by rules, for each robot, until another rule replaces it
-- Paper: eq:policy, app:foundations
-- Grain: one row per PolicyRuleSet or RolePolicyRuleSet event and robot for which it comes into force; a rule for every
--   robot, or for a role, has one row for each member of the fleet that it applies to, including later members; a robot
--   with a rule of its own is a member even if no record says that it joined
-- Key: run_id, seq, robot
-- Units: set_us, until_us microseconds of run time, half-open; seq, until_seq positions in the run
-- NULL: role, domain for a rule about no role (an empty domain is the whole fleet); capability, context when the rule
--   is about all of them; until_us, until_seq when nothing replaced it; decided_by for initial settings of the fleet
-- Example: fsar-ledger query facts/policy_rules LEDGER
WITH stated AS (
    SELECT
        run_id, seq, time_us, scope, robot, capability, context, outcome, decided_by,
        NULL AS role,
        NULL AS domain,
        CASE WHEN robot IS NOT NULL THEN 1024 END AS nearness
    FROM policy_rule_set
    UNION ALL BY NAME
    SELECT
        run_id, seq, time_us, scope, role, outcome, domain, capability, context, decided_by,
        NULL AS robot,
        CASE domain WHEN '' THEN 0 ELSE least(len(string_split(domain, '/')), 1023) END AS nearness
    FROM role_policy_rule_set
),

members AS (
    SELECT run_id, robot, role, domain
    FROM fleet_members
    UNION ALL
    SELECT DISTINCT
        ruled.run_id, ruled.robot,
        NULL AS role,
        NULL AS domain
    FROM policy_rule_set AS ruled
    ANTI JOIN fleet_members AS joined ON ruled.run_id = joined.run_id AND ruled.robot = joined.robot
    WHERE ruled.robot IS NOT NULL
),

of_members AS (
    SELECT
        stated.run_id, stated.seq, stated.time_us, stated.scope, stated.capability, stated.context, stated.outcome,
        stated.decided_by, stated.role, stated.domain, stated.nearness, members.robot
    FROM stated
    INNER JOIN members
        ON
            stated.run_id = members.run_id
            AND CASE
                WHEN stated.role IS NULL THEN coalesce(stated.robot, members.robot) = members.robot
                ELSE
                    stated.role = members.role
                    AND (
                        stated.domain IN ('', coalesce(members.domain, ''))
                        OR starts_with(members.domain, stated.domain || '/')
                    )
            END
),

in_force AS (
    -- A rule replaces those of the same scope, capability and context. One for the robot itself also replaces those for
    -- its role, and one for a smaller domain those for larger ones, but not the reverse. Rules for every robot hold in
    -- addition to the others.
    SELECT *
    FROM of_members
    QUALIFY
        nearness IS NULL
        OR nearness
        >= max(nearness) OVER (PARTITION BY run_id, robot, nearness IS NULL, scope, capability, context ORDER BY seq)
)

SELECT
    run_id, seq,
    time_us AS set_us,
    scope, role, domain, capability, context, outcome, decided_by,
    lead(time_us) OVER same AS until_us,
    lead(seq) OVER same AS until_seq,
    robot
FROM in_force
WINDOW same AS (PARTITION BY run_id, robot, nearness IS NULL, scope, capability, context ORDER BY seq)
