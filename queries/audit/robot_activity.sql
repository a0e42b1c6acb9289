-- Title: What a robot was doing at a time
-- Paper: sec:model:robot
-- Grain: one row per run, robot and action that it does or helps with; a robot that had joined and had none has one
--   row: `off`, `departed` or `idle`. Of an action that it does and helps with at once, what began last
-- Key: run_id, robot, action_id?
-- Units: since_us microseconds of run time; at seconds, by default after the end of every run
-- NULL: action_id, since_us, on_behalf_of when no action was in progress; on_behalf_of also when the robot helps
--   another; doing also when nothing is on record and the run does not observe execution and recovery, or an action was
--   in progress that began before the record, or it went off, or departed, and returns of such robots are not recorded.
--   Executions are only reported where a source records how they end, and help where it records that of help
-- Example: fsar-ledger query audit/robot_activity LEDGER --param run=RUN --param robot=robot/C1 --param at=20
--   answers executing B1-1/2.1 for robot/B1 since 18.0 s
-- Parameters: run: run = all, robot: robot = all, at: time = end
WITH doings (type, doing) AS (
    VALUES
    ('ExecutionQueued.v1', 'queued'), ('ApproachStarted.v1', 'approaching'), ('ExecutionHeld.v1', 'held by policy'),
    ('ExecutionStarted.v1', 'executing'), ('ExecutionResumed.v1', 'executing'), ('ExecutionPaused.v1', 'paused'),
    ('ExecutionHalted.v1', 'off'), ('ExecutionPreempted.v1', 'preempted'), ('ExecutionFailed.v1', 'recovering'),
    ('AssistanceAdmitted.v1', 'helping'), ('ExecutionFinished.v1', NULL), ('ExecutionWithdrawn.v1', NULL),
    ('AssistanceEnded.v1', NULL), ('AssistanceFailed.v1', NULL)
),

latest AS (
    SELECT
        events.run_id, coalesce(events.helper, events.robot) AS robot, events.action_id,
        arg_max(coalesce(doings.doing, 'done'), events.seq) AS doing,
        arg_max(events.time_us, events.seq) AS since_us,
        arg_max(events.on_behalf_of, events.seq) FILTER (WHERE events.on_behalf_of IS NOT NULL) AS on_behalf_of
    FROM event_principals AS events
    INNER JOIN doings ON events.type = doings.type
    INNER JOIN run_started AS runs ON events.run_id = runs.run_id
    WHERE
        $run IN ('all', events.run_id) AND events.time_us <= $at_us::BIGINT
        AND if(
            starts_with(events.type, 'Assistance'),
            list_contains(observes, 'recovery') OR list_has_all(records, ['AssistanceEnded', 'AssistanceFailed']),
            list_contains(observes, 'execution') OR list_has_all(records, ['ExecutionFinished', 'ExecutionWithdrawn'])
        )
    -- A helper may have an action of its own in progress and help with another.
    GROUP BY events.run_id, coalesce(events.helper, events.robot), events.action_id, events.helper IS NOT NULL
),

members AS (
    -- Records of other systems may not say who joined.
    SELECT run_id, robot FROM fleet_members
    WHERE joined_us <= $at_us::BIGINT
    UNION
    SELECT run_id, robot FROM latest
    WHERE doing <> 'done' AND robot IS NOT NULL
),

gone AS (
    SELECT run_id, robot FROM event_principals
    WHERE type IN ('RobotJoined.v1', 'RobotDeparted.v1', 'RobotReturned.v1') AND time_us <= $at_us::BIGINT
    GROUP BY run_id, robot
    HAVING arg_max(type, seq) = 'RobotDeparted.v1'
)

SELECT
    members.run_id, members.robot,
    CASE
        WHEN latest.doing IS NOT NULL THEN latest.doing
        WHEN outages.robot IS NOT NULL THEN if(outages.is_end_told, 'off', NULL)
        WHEN gone.robot IS NOT NULL
            THEN if(list_has_any(list_cat(runs.observes, runs.records), ['fleet', 'RobotReturned']), 'departed', NULL)
        WHEN past.until_us > $at_us::BIGINT THEN NULL
        WHEN list_has_all(runs.observes, ['execution', 'recovery']) THEN 'idle'
    END AS doing,
    latest.action_id, latest.on_behalf_of, latest.since_us
FROM members
INNER JOIN run_started AS runs ON members.run_id = runs.run_id
LEFT JOIN latest ON members.run_id = latest.run_id AND members.robot = latest.robot AND latest.doing <> 'done'
LEFT JOIN outages
    ON
        members.run_id = outages.run_id AND members.robot = outages.robot AND outages.what = 'off'
        AND outages.since_us <= $at_us::BIGINT AND (outages.until_us IS NULL OR outages.until_us > $at_us::BIGINT)
LEFT JOIN gone ON members.run_id = gone.run_id AND members.robot = gone.robot
LEFT JOIN busy_before AS past ON members.run_id = past.run_id AND members.robot = past.robot
WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot)
QUALIFY row_number() OVER (PARTITION BY members.run_id, members.robot, action_id ORDER BY latest.since_us DESC) = 1
