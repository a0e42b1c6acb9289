-- Title: Membership periods: joined, suspected, departed and returned
-- Paper: eq:fleet, sec:discussion:heterogeneity
-- Grain: one row per period in which a robot was a member: from joining or returning to its departure
-- Key: run_id, robot, fence?
-- Units: began_us, ended_us microseconds of run time; fence how often it had departed before; suspected, cleared how
--   often within the period
-- NULL: began_us, began_seq where its joining is not on record; ended_us, how, ended_by if it is a member to the end of
--   the run; ended_by where the record names no principal; fence, suspected, cleared when there is none on record and
--   the run does not record them
-- Example: fsar-ledger query audit/memberships LEDGER --param run=RUN --param robot=robot/B1
--   answers robot/B1, fence 0, began at 0.0 s, suspected 0, cleared 0
-- Parameters: run: run = all, robot: robot = all
WITH changes AS (
    SELECT run_id, robot, seq, time_us, 'began' AS change, NULL AS how, NULL AS by_whom FROM robot_joined
    UNION ALL
    SELECT run_id, robot, seq, time_us, 'began' AS change, NULL AS how, NULL AS by_whom FROM robot_returned
    UNION ALL
    SELECT run_id, robot, seq, time_us, 'ended' AS change, reason AS how, decided_by AS by_whom FROM robot_departed
    UNION ALL
    SELECT run_id, robot, seq, time_us, 'suspected' AS change, NULL AS how, NULL AS by_whom FROM robot_suspected
    UNION ALL
    SELECT run_id, robot, seq, time_us, 'cleared' AS change, NULL AS how, NULL AS by_whom FROM robot_cleared
),

numbered AS (
    SELECT
        run_id, robot, seq, time_us, change, how, by_whom,
        sum((change = 'ended')::INTEGER) OVER (
            PARTITION BY run_id, robot ORDER BY seq ROWS BETWEEN UNBOUNDED PRECEDING AND CURRENT ROW
        ) - (change = 'ended')::INTEGER AS fence
    FROM changes
    WHERE $run IN ('all', run_id) AND $robot IN ('all', robot)
),

recorded AS (
    SELECT run_id, list_cat(observes, records) AS told FROM run_started
)

SELECT
    numbered.run_id, numbered.robot,
    nullif(numbered.fence::BIGINT, if(list_has_any(told, ['fleet', 'RobotDeparted']), NULL, 0)) AS fence,
    min(time_us) FILTER (WHERE change = 'began') AS began_us,
    min(seq) FILTER (WHERE change = 'began') AS began_seq,
    min(time_us) FILTER (WHERE change = 'ended') AS ended_us,
    min(how) FILTER (WHERE change = 'ended') AS how,
    min(by_whom) FILTER (WHERE change = 'ended') AS ended_by,
    nullif(count(*) FILTER (WHERE change = 'suspected'), if(list_has_any(told, ['fleet', 'RobotSuspected']), NULL, 0))
        AS suspected,
    nullif(count(*) FILTER (WHERE change = 'cleared'), if(list_has_any(told, ['fleet', 'RobotCleared']), NULL, 0))
        AS cleared
FROM numbered
INNER JOIN recorded ON numbered.run_id = recorded.run_id
GROUP BY numbered.run_id, numbered.robot, numbered.fence, told
HAVING numbered.fence = 0 OR count(*) FILTER (WHERE change = 'began') > 0
