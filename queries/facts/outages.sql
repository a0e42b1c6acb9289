-- Title: Spells in which a robot was off, its link was down, or its actuator was degraded
-- Paper: sec:evaluation:simulator
-- Grain: one row per RobotWentOff, LinkWentDown or ActuatorDegraded event
-- Key: run_id, seq
-- Units: since_us, until_us microseconds of run time
-- NULL: until_us when nothing ended it within the run
-- Example: fsar-ledger query facts/outages LEDGER
WITH edges AS (
    SELECT
        run_id, seq, time_us, type, robot,
        CASE
            WHEN type IN ('RobotWentOff.v1', 'RobotCameBack.v1') THEN 'off'
            WHEN type IN ('LinkWentDown.v1', 'LinkCameUp.v1') THEN 'unlinked'
            WHEN type IN ('ActuatorDegraded.v1', 'ActuatorServiced.v1') THEN 'degraded'
        END AS what
    FROM event_principals
),

spells AS (
    SELECT
        run_id, seq, robot, what, type,
        time_us AS since_us,
        lead(time_us) OVER (PARTITION BY run_id, robot, what ORDER BY seq) AS until_us
    FROM edges
    WHERE what IS NOT NULL
)

SELECT run_id, seq, robot, what, since_us, until_us
FROM spells
WHERE type IN ('RobotWentOff.v1', 'LinkWentDown.v1', 'ActuatorDegraded.v1')
