-- Title: Times when a robot was off, its link was down, or its actuator was degraded
-- Paper: sec:evaluation:simulator
-- Grain: one row per RobotWentOff, LinkWentDown or ActuatorDegraded event
-- Key: run_id, seq
-- Units: since_us, until_us microseconds of run time; is_end_told whether an end is, or would be, on record; if not,
--   until_us is when a robot that went off began an action again, or the next such period began
-- NULL: until_us when nothing ended it within the run
-- Example: fsar-ledger query facts/outages LEDGER
WITH edges (type, what, ended_by, concern) AS (
    VALUES
    ('RobotWentOff.v1', 'off', 'RobotCameBack', 'world'), ('RobotCameBack.v1', 'off', NULL, NULL),
    ('LinkWentDown.v1', 'unlinked', 'LinkCameUp', 'world'), ('LinkCameUp.v1', 'unlinked', NULL, NULL),
    ('ActuatorDegraded.v1', 'degraded', 'ActuatorServiced', 'supervision'),
    ('ActuatorServiced.v1', 'degraded', NULL, NULL)
),

spells AS (
    SELECT
        events.run_id, events.seq, events.robot, edges.what, edges.ended_by,
        events.time_us AS since_us,
        lead(events.time_us) OVER by_robot AS until_us,
        coalesce(lead(events.type) OVER by_robot = edges.ended_by || '.v1', FALSE)
        OR coalesce(list_contains(runs.observes, edges.concern), FALSE)
        OR coalesce(list_contains(runs.records, edges.ended_by), FALSE) AS is_end_told
    FROM event_principals AS events
    INNER JOIN edges ON events.type = edges.type
    INNER JOIN run_started AS runs ON events.run_id = runs.run_id
    WINDOW by_robot AS (PARTITION BY events.run_id, events.robot, edges.what ORDER BY events.seq)
),

begun AS (
    SELECT run_id, robot, seq, time_us, 'off' AS what FROM execution_events
    WHERE type IN ('ApproachStarted.v1', 'ExecutionStarted.v1', 'ExecutionResumed.v1')
)

SELECT
    spells.run_id, spells.seq, spells.robot, spells.what, spells.since_us,
    if(spells.is_end_told, spells.until_us, least(spells.until_us, begun.time_us)) AS until_us,
    spells.is_end_told
FROM spells
ASOF LEFT JOIN begun
    ON
        spells.run_id = begun.run_id AND spells.robot = begun.robot AND spells.what = begun.what
        AND spells.seq < begun.seq
WHERE spells.ended_by IS NOT NULL
