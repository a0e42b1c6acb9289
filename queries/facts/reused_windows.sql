-- Title: Policy windows that open under a name that was closed before, so that no rule tells when they close
-- Paper: eq:policy
-- Grain: one row per PolicyWindowOpened event of a robot and scope whose window of that name was closed before
-- Key: run_id, seq
-- Units: opened_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query facts/reused_windows LEDGER
-- Rules pair a window with the first closing of its name. Give each window a name of its own.
SELECT
    opened.run_id, opened.seq, opened.robot, opened.scope,
    opened."window" AS window_name,
    opened.outcome,
    opened.time_us AS opened_us
FROM policy_window_opened AS opened
SEMI JOIN policy_window_closed AS closed
    ON
        opened.run_id = closed.run_id AND opened.robot = closed.robot AND opened.scope = closed.scope
        AND opened."window" = closed."window" AND opened.seq > closed.seq
