-- Title: The execution state of a robot at a time: off, idle, executing, degraded, failed or departed
-- Paper: sec:evaluation:simulator, sec:model:robot
-- Grain: one row per run and robot that had joined by then, had an action in progress or had an outage
-- Key: run_id, robot
-- Units: at seconds of run time; the default time is after the end of every run
-- NULL: action_id (of several one that failed, else the first that does not wait) when no action was in progress; state
--   when not on record and not all is observed, it was off or busy since before the record, or no return is recorded
-- Example: fsar-ledger query audit/robot_state_at LEDGER --param at=31 answers robot/D1 is failed, A1-1/5.1 in hand
-- Parameters: run: run = all, robot: robot = all, at: time = end
WITH past AS (
    SELECT events.* FROM event_principals AS events INNER JOIN run_started AS runs ON events.run_id = runs.run_id
    WHERE
        $run IN ('all', events.run_id) AND events.time_us <= $at_us::BIGINT
        AND if( -- nothing is reported whose ends are not recorded
            starts_with(events.type, 'Assistance'),
            list_contains(observes, 'recovery') OR list_has_all(records, ['AssistanceEnded', 'AssistanceFailed']),
            NOT regexp_matches(events.type, '^(Execution|Approach)') OR list_contains(observes, 'execution')
            OR list_has_all(records, ['ExecutionFinished', 'ExecutionWithdrawn'])
        )
),

outward AS ( -- failures that another principal than the robot is recovering
    SELECT run_id, coalesce(failed_action, action_id) AS action_id FROM past
    WHERE type IN ('RecoveryEscalated.v1', 'FailureResolved.v1')
    GROUP BY run_id, coalesce(failed_action, action_id)
    HAVING arg_max(type, seq) = 'RecoveryEscalated.v1'
),

in_hand AS (
    SELECT
        run_id, action_id, coalesce(helper, robot) AS robot, helper IS NOT NULL AS is_help, min(seq) AS since_seq,
        arg_max(type, seq) AS last_type, last_type IN ('ExecutionQueued.v1', 'ExecutionPreempted.v1') AS is_waiting
    FROM past
    WHERE regexp_matches(type, '^(Execution|ApproachStarted|Assistance(Admitted|Ended|Failed))')
    GROUP BY run_id, coalesce(helper, robot), action_id, helper IS NOT NULL
    HAVING NOT regexp_matches(last_type, '^(Execution(Finished|Withdrawn)|Assistance(Ended|Failed))')
),

held AS (
    SELECT
        in_hand.run_id, in_hand.robot, in_hand.action_id,
        in_hand.last_type = 'ExecutionFailed.v1' OR (outward.action_id IS NOT NULL AND NOT in_hand.is_help) AS is_failed
    FROM in_hand
    LEFT JOIN outward ON in_hand.run_id = outward.run_id AND in_hand.action_id = outward.action_id
    QUALIFY row_number() OVER (PARTITION BY in_hand.run_id, robot ORDER BY NOT is_failed, is_waiting, since_seq) = 1
),

members AS (
    SELECT run_id, robot, list(what) AS amiss FROM (
        SELECT run_id, robot, if(is_end_told, what, 'perhaps ' || what) AS what, since_us, until_us FROM outages
        UNION ALL
        SELECT run_id, robot, 'degraded' AS what, since_us, until_us FROM advertisements
        WHERE availability = 'degraded'
        UNION ALL
        SELECT run_id, robot, arg_max(type, seq) AS what, 0 AS since_us, NULL AS until_us FROM past
        WHERE type IN ('RobotJoined.v1', 'RobotDeparted.v1', 'RobotReturned.v1')
        GROUP BY run_id, robot
        UNION ALL -- records of other systems may not say who joined
        SELECT run_id, robot, NULL AS what, 0 AS since_us, NULL AS until_us FROM held
    ) AS spells
    WHERE robot IS NOT NULL AND since_us <= $at_us::BIGINT AND (until_us IS NULL OR until_us > $at_us::BIGINT)
    GROUP BY run_id, robot
)

SELECT
    members.run_id, members.robot,
    CASE
        WHEN list_contains(members.amiss, 'off') THEN 'off' WHEN list_contains(members.amiss, 'perhaps off') THEN NULL
        WHEN held.is_failed THEN 'failed' WHEN list_contains(members.amiss, 'degraded') THEN 'degraded'
        WHEN held.robot IS NOT NULL THEN 'executing'
        WHEN list_contains(members.amiss, 'RobotDeparted.v1')
            THEN if(list_has_any(list_cat(runs.observes, runs.records), ['fleet', 'RobotReturned']), 'departed', NULL)
        WHEN past.until_us > $at_us::BIGINT THEN NULL
        WHEN list_has_all(runs.observes, ['execution', 'recovery', 'registry', 'supervision', 'world']) THEN 'idle'
    END AS state, held.action_id
FROM members
INNER JOIN run_started AS runs ON members.run_id = runs.run_id
LEFT JOIN held ON members.run_id = held.run_id AND members.robot = held.robot
LEFT JOIN busy_before AS past ON members.run_id = past.run_id AND members.robot = past.robot
WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot)
