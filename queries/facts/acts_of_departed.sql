-- Title: Acts of robots that were not members: after their departure, or under an old fencing number
-- Paper: sec:discussion:heterogeneity, eq:auth
-- Grain: one row per event by which a robot takes, begins or goes on with work for the fleet between its departure and
--   its return or new joining (a new joining gives it no number); and per claim of a returned robot under a smaller
--   number than its departures until then
-- Key: run_id, seq
-- Units: time_us microseconds of run time; fence the number of the claim, 0 where it has none; departures until then
-- NULL: action_id where the record names none; fence of acts other than claims, and of claims in a run that does not
--   record their numbers, none of which is under an old one; no row in a run that does not record returns
-- Example: fsar-ledger query facts/acts_of_departed LEDGER
WITH acts AS (
    SELECT run_id, seq, time_us, 'RequestAccepted.v1' AS type, action_id, decided_by AS robot, NULL AS fence
    FROM request_accepted
    UNION ALL
    SELECT run_id, seq, time_us, 'ApproachStarted.v1' AS type, action_id, robot, NULL AS fence
    FROM approach_started
    UNION ALL
    SELECT run_id, seq, time_us, 'ExecutionStarted.v1' AS type, action_id, robot, NULL AS fence
    FROM execution_started
    UNION ALL
    SELECT run_id, seq, time_us, 'ExecutionResumed.v1' AS type, action_id, robot, NULL AS fence
    FROM execution_resumed
    UNION ALL
    SELECT run_id, seq, time_us, 'ExecutionFinished.v1' AS type, action_id, robot, NULL AS fence
    FROM execution_finished
    UNION ALL
    SELECT run_id, seq, time_us, 'AssistanceAdmitted.v1' AS type, action_id, helper AS robot, NULL AS fence
    FROM assistance_admitted
    UNION ALL
    SELECT
        claimed.run_id, claimed.seq, claimed.time_us, 'AuthorityClaimed.v1' AS type, claimed.action_id,
        claimed.claimant AS robot,
        coalesce(
            claimed.fence,
            if(list_has_any(list_cat(runs.observes, runs.records), ['authority', 'AuthorityClaimed.fence']), 0, NULL)
        ) AS fence
    FROM authority_claimed AS claimed
    INNER JOIN run_started AS runs ON claimed.run_id = runs.run_id
),

changes AS (
    SELECT run_id, robot, since_seq AS seq, 'departed' AS change FROM departed_robots
    UNION ALL
    SELECT run_id, robot, seq, 'returned' AS change FROM robot_returned
    UNION ALL
    SELECT run_id, robot, seq, 'joined' AS change FROM robot_joined
    WHERE (run_id, robot) IN (SELECT (run_id, robot) FROM departed_robots)
)

SELECT
    acts.run_id, acts.seq, acts.time_us, acts.type, acts.action_id, acts.robot, acts.fence,
    arg_max(changes.change, changes.seq) = 'departed' AS is_away,
    count(*) FILTER (WHERE changes.change = 'departed') AS departures
FROM acts
INNER JOIN changes ON acts.run_id = changes.run_id AND acts.robot = changes.robot AND acts.seq > changes.seq
GROUP BY ALL
HAVING
    is_away OR (arg_max(changes.change, changes.seq) = 'returned' AND acts.fence < departures)
