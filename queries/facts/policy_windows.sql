-- Title: Windows in which a policy does not allow
-- Paper: eq:policy
-- Grain: one row per PolicyWindowOpened event
-- Units: opened_us, closed_us microseconds of run time, half-open: the window is over at closed_us
-- NULL: closed_us when the window was never closed
-- Example: fsar-ledger query facts/policy_windows LEDGER
WITH closings AS (
    SELECT
        run_id,
        robot,
        scope,
        "window",
        min(time_us) AS closed_us
    FROM policy_window_closed
    GROUP BY run_id, robot, scope, "window"
)

SELECT
    opened.run_id,
    opened.seq,
    opened.robot,
    opened.scope,
    opened."window",
    opened.outcome,
    opened.time_us AS opened_us,
    closings.closed_us
FROM policy_window_opened AS opened
LEFT JOIN closings
    ON opened.run_id = closings.run_id AND opened.robot = closings.robot AND opened.scope = closings.scope AND opened."window" = closings."window"
