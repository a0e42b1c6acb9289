-- Title: Policy restrictions: windows of the world, and rules that deny or ask for review
-- Paper: eq:policy, app:foundations
-- Grain: one row per PolicyWindowOpened event, and per PolicyRuleSet or RolePolicyRuleSet event whose outcome is not
--   allow and robot for which it holds
-- Key: run_id, seq, robot
-- Units: opened_us, closed_us microseconds of run time, half-open: it is over at closed_us; seq, closed_seq positions
--   in the run
-- NULL: window_name for a rule; capability, context when it holds for all of them; closed_us, closed_seq when it was
--   never closed or replaced
-- Example: fsar-ledger query facts/policy_windows LEDGER
SELECT
    opened.run_id, opened.seq, opened.robot, opened.scope,
    opened."window" AS window_name,
    NULL::VARCHAR AS capability,
    NULL::VARCHAR AS context,
    opened.outcome,
    opened.time_us AS opened_us,
    closed.time_us AS closed_us,
    closed.seq AS closed_seq
FROM policy_window_opened AS opened
-- The first closing after it: a window may open again under the same name.
ASOF LEFT JOIN policy_window_closed AS closed
    ON
        opened.run_id = closed.run_id AND opened.robot = closed.robot AND opened.scope = closed.scope
        AND opened."window" = closed."window" AND opened.seq < closed.seq
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
