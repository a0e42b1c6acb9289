-- Title: Absences of robots from the fleet: from departure until they returned or joined anew
-- Paper: sec:discussion:heterogeneity
-- Grain: one row per RobotDeparted event of a run that records returns
-- Key: run_id, robot, since_seq
-- Units: since_us, until_us microseconds of run time, half-open; since_seq, until_seq the events
-- NULL: until_us and until_seq of a robot that neither returned nor joined anew by the end of the run
-- Example: fsar-ledger query facts/departed_robots LEDGER
WITH back AS (
    SELECT run_id, robot, seq, time_us FROM robot_returned
    UNION ALL
    SELECT run_id, robot, seq, time_us FROM robot_joined
)

SELECT
    departed.run_id, departed.robot,
    departed.seq AS since_seq,
    departed.time_us AS since_us,
    back.seq AS until_seq,
    back.time_us AS until_us
FROM robot_departed AS departed
INNER JOIN run_started AS runs
    ON
        departed.run_id = runs.run_id
        AND (list_contains(runs.observes, 'fleet') OR list_contains(runs.records, 'RobotReturned'))
ASOF LEFT JOIN back ON departed.run_id = back.run_id AND departed.robot = back.robot AND departed.seq < back.seq
