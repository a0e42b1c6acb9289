-- Title: What may end a hold: an approval, a window of the robot's that closes, a rule that comes into force for it, word of the fleet's rule
-- Paper: eq:policy, sec:architecture:fleet
-- Grain: one row per such event; per robot, where a rule is about several
-- Units: seq position in the run
-- NULL: robot for an approval, which is about one action; action_id for the others, which are about whatever the robot has in hand
-- Example: fsar-ledger query facts/hold_ends LEDGER
WITH holders AS (
    SELECT DISTINCT
        run_id,
        robot
    FROM execution_held
)

SELECT
    run_id,
    seq,
    NULL AS robot,
    action_id
FROM approvals
UNION ALL
SELECT
    run_id,
    seq,
    robot,
    NULL AS action_id
FROM events
WHERE type IN ('PolicyWindowClosed.v1', 'FleetRuleLearned.v1')
UNION ALL
SELECT
    run_id,
    seq,
    robot,
    NULL AS action_id
FROM policy_rules
WHERE role IS NOT NULL
UNION ALL
SELECT
    rules.run_id,
    rules.seq,
    held.robot,
    NULL AS action_id
FROM policy_rule_set AS rules
INNER JOIN holders AS held
    ON rules.run_id = held.run_id AND coalesce(rules.robot, held.robot) = held.robot -- whether or not it is known to have joined
