-- Title: What may end a hold: an approval, a closing window of the robot's, a new rule for it, news of the fleet's
--   rule
-- Paper: eq:policy, sec:architecture:fleet
-- Grain: one row per such event; per robot, where a rule is about several
-- Key: run_id, seq, robot?
-- Units: seq position in the run
-- NULL: robot for an approval, which is about one action; action_id for the others, which are about whatever the robot
--   has in hand
-- Example: fsar-ledger query facts/hold_ends LEDGER
WITH holders AS (
    SELECT DISTINCT run_id, robot
    FROM execution_held
)

SELECT run_id, seq, NULL AS robot, action_id
FROM supervisor_responded
WHERE purpose = 'review' AND coalesce(approves, TRUE) -- a response that does not say whether it approves does
UNION ALL
SELECT run_id, seq, robot, NULL AS action_id
FROM policy_window_closed
UNION ALL
SELECT run_id, seq, robot, NULL AS action_id
FROM fleet_rule_learned
UNION ALL
SELECT run_id, seq, robot, NULL AS action_id
FROM policy_rules
WHERE role IS NOT NULL
UNION ALL
SELECT rules.run_id, rules.seq, held.robot, NULL AS action_id
FROM policy_rule_set AS rules
INNER JOIN holders AS held
    -- whether or not it is known to have joined
    ON rules.run_id = held.run_id AND coalesce(rules.robot, held.robot) = held.robot
