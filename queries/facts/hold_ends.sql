-- Title: Events that may end a hold, besides approvals: closed windows of the robot, new rules for it, news of fleet
--   rules
-- Paper: eq:policy, sec:architecture:fleet
-- Grain: one row per such event and robot that it is about
-- Key: run_id, seq, robot
-- Units: seq position in the run
-- NULL: never
-- Example: fsar-ledger query facts/hold_ends LEDGER
WITH holders AS (
    SELECT DISTINCT run_id, robot
    FROM execution_held
)

SELECT run_id, seq, robot
FROM policy_window_closed
UNION ALL
SELECT run_id, seq, robot
FROM fleet_rule_learned
UNION ALL
SELECT run_id, seq, robot
FROM policy_rules
WHERE role IS NOT NULL
UNION ALL
SELECT rules.run_id, rules.seq, held.robot
FROM policy_rule_set AS rules
INNER JOIN holders AS held
    -- even if no record says that it joined
    ON rules.run_id = held.run_id AND coalesce(rules.robot, held.robot) = held.robot
UNION ALL
-- A robot of which no record says that it joined may have the role.
SELECT rules.run_id, rules.seq, held.robot
FROM role_policy_rule_set AS rules
INNER JOIN holders AS held ON rules.run_id = held.run_id
ANTI JOIN fleet_members AS members ON held.run_id = members.run_id AND held.robot = members.robot
