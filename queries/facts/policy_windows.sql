-- Title: When a policy does not allow: windows of the world, and rules that deny or ask for review
-- Paper: eq:policy, app:foundations
-- Grain: one row per PolicyWindowOpened event, and per PolicyRuleSet or RolePolicyRuleSet event whose outcome is not
--   allow and robot for which it holds
-- Key: run_id, seq, robot
-- Units: opened_us, closed_us microseconds of run time, half-open: it is over at closed_us; seq, closed_seq positions
--   in the run
-- NULL: window_name for a rule; capability, context when it holds for all of them; closed_us, closed_seq when it was
--   never closed or replaced
-- Example: fsar-ledger query facts/policy_windows LEDGER
WITH closings AS (
    SELECT
        run_id, robot, scope,
        "window",
        min(time_us) AS closed_us,
        min(seq) AS closed_seq
    FROM policy_window_closed
    GROUP BY run_id, robot, scope, "window"
)

SELECT
    opened.run_id, opened.seq, opened.robot, opened.scope,
    opened."window" AS window_name,
    NULL::VARCHAR AS capability,
    NULL::VARCHAR AS context,
    opened.outcome,
    opened.time_us AS opened_us,
    closings.closed_us, closings.closed_seq
FROM policy_window_opened AS opened
LEFT JOIN closings
    ON
        opened.run_id = closings.run_id AND opened.robot = closings.robot AND opened.scope = closings.scope
        AND opened."window" = closings."window"
UNION ALL
SELECT
    run_id, seq, robot, scope,
    NULL AS window_name,
    capability, context, outcome,
    set_us AS opened_us,
    until_us AS closed_us,
    until_seq AS closed_seq
FROM policy_rules
WHERE outcome <> 'allow'
