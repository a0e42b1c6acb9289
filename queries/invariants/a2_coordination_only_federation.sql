-- Title: A2 broken: a federation service or the coordinator executes
-- Paper: sec:architecture:invariants (A2), eq:federation
-- Grain: one row per event that names a service or the coordinator as executor, or as the body that moves or helps
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when the event is not tied to an action
-- Example: fsar-ledger query invariants/a2_coordination_only_federation LEDGER
SELECT
    run_id, seq, time_us, type, action_id,
    CASE
        WHEN executed_by = 'coordinator' OR starts_with(executed_by, 'service/')
            THEN executed_by || ' is named as the one that executes'
        WHEN robot = 'coordinator' OR starts_with(robot, 'service/') THEN robot || ' is named as the one that executes'
        ELSE helper || ' is named as the one that helps'
    END AS found
FROM event_principals
WHERE
    executed_by = 'coordinator'
    OR starts_with(executed_by, 'service/')
    OR robot = 'coordinator'
    OR starts_with(robot, 'service/')
    OR helper = 'coordinator'
    OR starts_with(helper, 'service/')
