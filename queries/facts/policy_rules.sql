-- Title: Policy that is set by rule, robot by robot, until another rule replaces it
-- Paper: eq:policy, app:foundations
-- Grain: one row per PolicyRuleSet event and robot that it is about; a rule for every robot is one row for each member of the fleet
-- Units: set_us, until_us microseconds of run time, half-open; seq, until_seq positions in the run
-- NULL: capability, context when the rule is about all of them; until_us, until_seq when nothing replaced it
-- Example: fsar-ledger query facts/policy_rules LEDGER
WITH rules AS (
    -- A rule replaces the one with the same scope, robot, capability and context.
    SELECT
        run_id,
        seq,
        time_us AS set_us,
        scope,
        robot,
        capability,
        context,
        outcome,
        decided_by,
        lead(time_us) OVER same AS until_us,
        lead(seq) OVER same AS until_seq
    FROM policy_rule_set
    WINDOW same AS (PARTITION BY run_id, scope, robot, capability, context ORDER BY seq)
)

SELECT
    rules.* EXCLUDE (robot),
    members.robot
FROM rules
INNER JOIN fleet_members AS members ON rules.run_id = members.run_id AND (rules.robot = members.robot OR rules.robot IS NULL)
