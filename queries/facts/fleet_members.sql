-- Title: The members of each fleet
-- Paper: eq:fleet, sec:discussion:heterogeneity
-- Grain: one row per run and robot that joined; of one that is recorded as joining again, as it did last
-- Key: run_id, robot
-- Units: joined_us microseconds of run time, and joined_seq the event, when it first joined; team counts from 1
-- NULL: supervisor for a robot without one of its own; domain where it joined the fleet's own; place where the fleet
--   has one place
-- Example: fsar-ledger query facts/fleet_members LEDGER
SELECT
    run_id, robot, role, team, supervisor, domain, place,
    min(time_us) OVER (PARTITION BY run_id, robot) AS joined_us,
    min(seq) OVER (PARTITION BY run_id, robot) AS joined_seq
FROM robot_joined
QUALIFY row_number() OVER (PARTITION BY run_id, robot ORDER BY seq DESC) = 1
