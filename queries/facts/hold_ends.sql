-- Title: What may end a hold, beside an approval: a closing window of the robot's, a new rule for it, news of the
--   fleet's rule
-- Paper: eq:policy, sec:architecture:fleet
-- Grain: one row per such event; per robot, where a rule is about several
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
    -- whether or not it is known to have joined
    ON rules.run_id = held.run_id AND coalesce(rules.robot, held.robot) = held.robot
