-- Title: When the record does not tell which policy of a robot was in force
-- Paper: eq:policy
-- Grain: one row per policy window of a foreign run that closes without having opened, and per opening of a window
--   under a name that was closed before: rules pair a window with the first closing of its name
-- Key: run_id, robot, scope, window_name, since_us
-- Units: since_us, until_us microseconds of run time, half-open
-- NULL: until_us when it is not known from then on
-- Example: fsar-ledger query facts/unknown_policy LEDGER
SELECT
    run_id, robot, scope,
    name AS window_name,
    0::BIGINT AS since_us,
    until_us,
    'the policy before the record' AS why
FROM begun_before
WHERE what = 'window'
UNION ALL
SELECT
    opened.run_id, opened.robot, opened.scope,
    opened."window" AS window_name,
    opened.time_us AS since_us,
    NULL::BIGINT AS until_us,
    'which window was closed' AS why
FROM policy_window_opened AS opened
SEMI JOIN policy_window_closed AS closed
    ON
        opened.run_id = closed.run_id AND opened.robot = closed.robot AND opened.scope = closed.scope
        AND opened."window" = closed."window" AND opened.seq > closed.seq
