-- Title: When a body served an action or helped with one, and its own motions
-- Paper: sec:evaluation:simulator
-- Grain: one row per approach, execution or resumption of an action, per help, and per routine motion
-- Key: run_id, seq
-- Units: began_us, ended_us microseconds of run time, half-open; a motion has no length
-- NULL: ended_us of an approach or a help without a recorded end; action_id and work of a motion
-- Example: fsar-ledger query facts/occupations LEDGER
-- Stored: it combines three views of events
-- An approach becomes the execution, and both end where the action stops, fails or is taken away; without a record of
-- that, an execution ends as planned. Two actions are the same work if they are for the same step of a task.
WITH moves AS (
    SELECT
        run_id, seq, time_us, action_id, robot, ends_us,
        FALSE AS is_help,
        type IN ('ApproachStarted.v1', 'ExecutionStarted.v1', 'ExecutionResumed.v1') AS begins
    FROM execution_events
    WHERE
        type IN (
            'ApproachStarted.v1',
            'ExecutionStarted.v1',
            'ExecutionResumed.v1',
            'ExecutionHeld.v1',
            'ExecutionPaused.v1',
            'ExecutionHalted.v1', 'ExecutionPreempted.v1', 'ExecutionFinished.v1', 'ExecutionWithdrawn.v1'
        )
    UNION ALL BY NAME
    SELECT
        run_id, seq, time_us, action_id,
        coalesce(helper, robot) AS robot,
        type <> 'ExecutionFailed.v1' AS is_help,
        type = 'AssistanceAdmitted.v1' AS begins
    FROM recovery_events
    WHERE type IN ('ExecutionFailed.v1', 'AssistanceAdmitted.v1', 'AssistanceEnded.v1', 'AssistanceFailed.v1')
),

ended AS (
    SELECT
        run_id, seq, time_us, action_id, robot, begins,
        coalesce(
            lead(time_us) OVER (PARTITION BY run_id, robot, action_id, is_help ORDER BY seq), ends_us
        ) AS ended_us
    FROM moves
),

works AS (
    SELECT
        run_id, action_id,
        arg_min(task_id || ' ' || step, seq) FILTER (step > 0) AS work
    FROM execution_queued
    GROUP BY run_id, action_id
)

SELECT
    ended.run_id, ended.seq, ended.robot, ended.action_id,
    coalesce(works.work, ended.action_id) AS work,
    ended.time_us AS began_us,
    ended.ended_us
FROM ended
LEFT JOIN works ON ended.run_id = works.run_id AND ended.action_id = works.action_id
WHERE ended.begins
UNION ALL
SELECT
    run_id, seq, robot,
    NULL AS action_id,
    NULL AS work,
    time_us AS began_us,
    time_us AS ended_us
FROM routine_performed
WHERE operation = 'motion'
