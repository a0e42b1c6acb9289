-- Title: The members of each fleet
-- Paper: eq:fleet, sec:discussion:heterogeneity
-- Grain: one row per run and robot that joined; a robot that is recorded as joining again has its last entry
-- Key: run_id, robot
-- Units: joined_us microseconds of run time, and joined_seq position, of its first joining; team counts from 1
-- NULL: supervisor for a robot without its own; team where the record has none; domain where it joined the fleet's
--   own domain; place where the fleet has only one
-- Example: fsar-ledger query facts/fleet_members LEDGER
SELECT
    run_id, robot, role, team, supervisor, domain, place,
    min(time_us) OVER (PARTITION BY run_id, robot) AS joined_us,
    min(seq) OVER (PARTITION BY run_id, robot) AS joined_seq
FROM robot_joined
QUALIFY row_number() OVER (PARTITION BY run_id, robot ORDER BY seq DESC) = 1
