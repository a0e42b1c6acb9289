-- Title: Departures and returns of robots, and the requests and tasks that ended because of them
-- Paper: sec:discussion:heterogeneity
-- Grain: one row per run in which a robot went off, was called away, was suspected, departed or returned
-- Key: run_id
-- Units: counts. away: times that a robot went off; announced, found_out: departures that were announced, or noticed by
--   silence; suspected, cleared, returned (or joined anew): robots each time; requests_failed: requests that ended as
--   failure(departed); tasks_recovered, tasks_abandoned: tasks of facts/tasks_of_departed that were completed, or given
--   up; acts: as in facts/acts_of_departed
-- NULL: a count when it would be 0 and the run does not record all that it counts; acts also when it does not record
--   who departed and returned
-- Example: fsar-ledger query audit/churn LEDGER --param run=RUN
--   answers nothing, since no robot leaves in the paper's scenarios; those of the scenario churn do
-- Parameters: run: run = all
WITH memberships AS (
    SELECT run_id, type, lag(type) OVER (PARTITION BY run_id, robot ORDER BY seq) AS type_before
    FROM event_principals
    WHERE type IN ('RobotJoined.v1', 'RobotDeparted.v1', 'RobotReturned.v1')
),

counted AS (
    SELECT run_id, 'away' AS what FROM robot_went_off
    UNION ALL
    SELECT run_id, 'called' AS what FROM robot_called_away
    UNION ALL
    SELECT run_id, if(reason = 'announced', 'announced', 'found_out') AS what FROM robot_departed
    UNION ALL
    SELECT run_id, 'suspected' AS what FROM robot_suspected
    UNION ALL
    SELECT run_id, 'cleared' AS what FROM robot_cleared
    UNION ALL
    SELECT run_id, 'returned' AS what FROM memberships
    WHERE type = 'RobotReturned.v1' OR (type = 'RobotJoined.v1' AND type_before = 'RobotDeparted.v1')
    UNION ALL
    SELECT run_id, 'failed' AS what FROM request_closed
    WHERE result = 'failure' AND cause = 'departed'
    UNION ALL
    SELECT run_id, outcome AS what FROM tasks_of_departed
    UNION ALL
    SELECT run_id, 'acts' AS what FROM acts_of_departed
),

recorded AS (
    -- A departure hits a task when it ends one of its requests, executions or recoveries.
    SELECT
        run_id,
        list_cat(observes, records) AS told,
        list_contains(observes, 'recovery') AND list_has_any(told, ['request', 'RequestClosed.cause']) AS tells_hits,
        list_contains(told, 'fleet') OR list_has_all(told, ['RobotDeparted', 'RobotReturned']) AS tells_absences,
        list_has_all(observes, ['request', 'execution', 'recovery', 'authority']) AS tells_acts
    FROM run_started
)

SELECT
    counted.run_id,
    nullif(count(*) FILTER (what = 'away'), if(list_has_any(told, ['world', 'RobotWentOff']), NULL, 0)) AS away,
    nullif(count(*) FILTER (what = 'announced'), if(list_has_any(told, ['fleet', 'RobotDeparted']), NULL, 0))
        AS announced,
    nullif(count(*) FILTER (what = 'found_out'), if(list_has_any(told, ['fleet', 'RobotDeparted']), NULL, 0))
        AS found_out,
    nullif(count(*) FILTER (what = 'suspected'), if(list_has_any(told, ['fleet', 'RobotSuspected']), NULL, 0))
        AS suspected,
    nullif(count(*) FILTER (what = 'cleared'), if(list_has_any(told, ['fleet', 'RobotCleared']), NULL, 0)) AS cleared,
    nullif(count(*) FILTER (what = 'returned'), if(list_has_any(told, ['fleet', 'RobotReturned']), NULL, 0))
        AS returned,
    nullif(count(*) FILTER (what = 'failed'), if(list_has_any(told, ['request', 'RequestClosed.cause']), NULL, 0))
        AS requests_failed,
    nullif(
        count(*) FILTER (what = 'completed'), if(tells_hits AND list_has_any(told, ['task', 'TaskCompleted']), NULL, 0)
    ) AS tasks_recovered,
    nullif(
        count(*) FILTER (what = 'abandoned'),
        if(tells_hits AND tells_absences AND list_has_any(told, ['task', 'TaskAbandoned']), NULL, 0)
    ) AS tasks_abandoned,
    if(tells_absences, nullif(count(*) FILTER (what = 'acts'), if(tells_acts, NULL, 0)), NULL) AS acts
FROM counted
INNER JOIN recorded ON counted.run_id = recorded.run_id
WHERE $run IN ('all', counted.run_id)
GROUP BY counted.run_id, told, tells_hits, tells_absences, tells_acts
