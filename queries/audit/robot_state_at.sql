-- Title: The execution state of a robot at a time: off, idle, executing, degraded or failed
-- Paper: sec:evaluation:simulator, sec:model:robot
-- Grain: one row per run and robot that had joined by then
-- Key: run_id, robot
-- Units: at seconds of run time; the default time is after the end of every run
-- NULL: action_id when nothing was in hand; of several things one that failed, else the first that does not wait; state
--   when nothing is on record and not all of execution, recovery, registry, supervision and world is observed, or
--   it was off, or had something in hand, since before the record
-- Example: fsar-ledger query audit/robot_state_at LEDGER --param run=RUN --param robot=robot/D1 --param at=31
--   answers robot/D1 is failed, with A1-1/5.1 in hand
-- Parameters: run: run = all, robot: robot = all, at: time = end
WITH past AS (
    SELECT events.*
    FROM event_principals AS events
    INNER JOIN runs ON events.run_id = runs.run_id
    WHERE
        $run IN ('all', events.run_id) AND events.time_us <= $at_us::BIGINT
        AND (list_contains(runs.observes, 'execution') OR NOT starts_with(events.type, 'Execution')) -- else none ends
),

outward AS ( -- failures that are being recovered by others than the robot
    SELECT run_id, coalesce(failed_action, action_id) AS action_id
    FROM past
    WHERE type IN ('RecoveryEscalated.v1', 'FailureResolved.v1')
    GROUP BY run_id, coalesce(failed_action, action_id)
    HAVING arg_max(type, seq) = 'RecoveryEscalated.v1'
),

in_hand AS (
    SELECT
        run_id, action_id, coalesce(helper, robot) AS robot,
        helper IS NOT NULL AS is_help, -- beside what it does itself
        min(seq) AS since_seq, arg_max(type, seq) AS last_type,
        last_type IN ('ExecutionQueued.v1', 'ExecutionPreempted.v1') AS is_waiting
    FROM past
    WHERE regexp_matches(type, '^(Execution|ApproachStarted|Assistance(Admitted|Ended|Failed))')
    GROUP BY run_id, coalesce(helper, robot), action_id, helper IS NOT NULL
    HAVING
        last_type NOT IN ('ExecutionFinished.v1', 'ExecutionWithdrawn.v1', 'AssistanceEnded.v1', 'AssistanceFailed.v1')
),

held AS (
    SELECT
        in_hand.run_id, in_hand.robot, in_hand.action_id,
        in_hand.last_type = 'ExecutionFailed.v1' OR (outward.action_id IS NOT NULL AND NOT in_hand.is_help) AS is_failed
    FROM in_hand
    LEFT JOIN outward ON in_hand.run_id = outward.run_id AND in_hand.action_id = outward.action_id
    WINDOW robots AS (PARTITION BY in_hand.run_id, in_hand.robot ORDER BY is_failed DESC, is_waiting ASC, since_seq ASC)
    QUALIFY row_number() OVER robots = 1
),

amiss AS (
    SELECT run_id, robot, what
    FROM outages
    WHERE since_us <= $at_us::BIGINT AND (until_us IS NULL OR until_us > $at_us::BIGINT)
    UNION
    SELECT run_id, robot, 'degraded' AS what
    FROM advertisements
    WHERE availability = 'degraded' AND since_us <= $at_us::BIGINT AND (until_us IS NULL OR until_us > $at_us::BIGINT)
)

SELECT
    members.run_id, members.robot,
    CASE
        WHEN off.robot IS NOT NULL THEN 'off'
        WHEN held.is_failed THEN 'failed'
        WHEN degraded.robot IS NOT NULL THEN 'degraded'
        WHEN held.robot IS NOT NULL THEN 'executing'
        WHEN past.until_us > $at_us::BIGINT THEN NULL
        WHEN list_has_all(runs.observes, ['execution', 'recovery', 'registry', 'supervision', 'world']) THEN 'idle'
    END AS state,
    held.action_id
FROM fleet_members AS members
INNER JOIN runs ON members.run_id = runs.run_id
LEFT JOIN held ON members.run_id = held.run_id AND members.robot = held.robot
LEFT JOIN amiss AS off ON members.run_id = off.run_id AND members.robot = off.robot AND off.what = 'off'
LEFT JOIN amiss AS degraded
    ON members.run_id = degraded.run_id AND members.robot = degraded.robot AND degraded.what = 'degraded'
LEFT JOIN busy_before AS past ON members.run_id = past.run_id AND members.robot = past.robot
WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot) AND members.joined_us <= $at_us::BIGINT
