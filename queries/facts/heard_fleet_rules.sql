-- Title: Fleet rules, and whether anybody who decides was told of each in time
-- Paper: eq:policy
-- Grain: one row per fleet rule (PolicyWindowOpened event of scope fleet)
-- Units: opened_us microseconds of run time
-- NULL: never; is_heard: the robot, or a copy that names the robot, was told between its opening and half a second (one message) after its end
-- Example: fsar-ledger query facts/heard_fleet_rules LEDGER
SELECT
    windows.run_id,
    windows.seq,
    windows.robot,
    windows.outcome,
    windows.opened_us,
    count(heard.seq) > 0 AS is_heard
FROM policy_windows AS windows
LEFT JOIN events AS heard
    ON
        windows.run_id = heard.run_id AND heard.time_us BETWEEN windows.opened_us AND coalesce(windows.closed_us, heard.time_us) + 500000
        AND (
            (heard.type = 'FleetRuleLearned.v1' AND windows.robot = heard.robot AND windows.outcome = heard.outcome)
            OR (heard.type = 'CopySynced.v1' AND list_contains(list_concat(heard.fleet_deny, heard.fleet_review), windows.robot))
        )
WHERE windows.scope = 'fleet'
GROUP BY windows.run_id, windows.seq, windows.robot, windows.outcome, windows.opened_us
