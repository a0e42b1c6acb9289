-- Title: Until when a robot of another system may have been off or busy since before its record
-- Paper: sec:evaluation:simulator (robot state)
-- Grain: one row per robot of a foreign run that comes back, or whose record continues or ends an action, recovers from
--   a failure or ends help, without a recorded beginning of it
-- Key: run_id, robot
-- Units: until_us microseconds of run time, half-open: the record gives its state from then on; the greatest BIGINT if
--   it never does
-- NULL: never
-- Example: fsar-ledger query facts/busy_before LEDGER
WITH told AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type,
        if(events.type = 'AssistanceRequested.v1', events.robot, coalesce(events.helper, events.robot)) AS robot,
        if(starts_with(events.type, 'Robot'), 'off', coalesce(events.failed_action, events.action_id)) AS action_id,
        regexp_matches(events.type, '^Assistance[^R]') AS is_help,
        regexp_matches(events.type, '^(Recovery|AssistanceRequested|FailureResolved)') AS is_recovery
    FROM event_principals AS events
    INNER JOIN runs ON events.run_id = runs.run_id AND runs.kind = 'foreign'
    WHERE
        regexp_matches(
            events.type,
            '^(Execution|Approach|Recovery|FailureResolved|Assistance[^D]|Robot(WentOff|CameBack))'
        )
),

actions AS (
    SELECT
        run_id, robot,
        arg_min(type, seq) AS first_type,
        arg_min(is_recovery, seq) AS is_recovering,
        min(time_us) AS first_us,
        min(time_us) FILTER (WHERE NOT is_recovery) AS told_us
    FROM told
    WHERE robot IS NOT NULL AND action_id IS NOT NULL
    GROUP BY run_id, robot, action_id, is_help, starts_with(type, 'Robot')
)

SELECT
    run_id, robot,
    max(if(is_recovering, coalesce(told_us, 9223372036854775807), first_us)) AS until_us
FROM actions
WHERE
    first_type NOT IN (
        'ExecutionQueued.v1', 'ApproachStarted.v1', 'ExecutionHeld.v1', 'ExecutionStarted.v1', 'AssistanceAdmitted.v1',
        'RobotWentOff.v1'
    )
GROUP BY run_id, robot
