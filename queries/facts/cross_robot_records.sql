-- Title: Starts and ends of executions for another robot, and who began each
-- Paper: sec:architecture:invariants (A5), eq:request
-- Grain: one row per start for another robot, and per end of an execution that was started for another robot or by
--   another robot than ends it; without actions that were under way when the record began
-- Key: run_id, seq
-- Units: time_us microseconds of run time; begun_seq position of the start, or its own where the robot ends what it
--   did not begin; next_seq position of the task's next step or end
-- NULL: principals that the record does not name; began_by, on_behalf_of of an end without a start; next_seq and
--   is_given_up of a start, and of an end that no step or end of the task follows
-- Example: fsar-ledger query facts/cross_robot_records LEDGER
-- Stored: several invariants of an audit read it
WITH turns AS (
    SELECT run_id, seq, action_id, robot, type IN ('ExecutionStarted.v1', 'ExecutionResumed.v1') AS is_begun
    FROM event_principals
    WHERE
        type IN (
            'ExecutionStarted.v1', 'ExecutionResumed.v1', 'ExecutionFinished.v1', 'ExecutionFailed.v1',
            'ExecutionWithdrawn.v1'
        )
),

-- A robot that began, and from which the action was not taken, ends its own execution, even if others began, too.
finished AS (
    SELECT
        done.run_id, done.seq, done.time_us, done.task_id, done.action_id, done.requested_by, done.executed_by,
        done.supervised_by, done.robot,
        if(act.is_begun, done.robot, starts.robot) AS began_by,
        if(act.is_begun, own.on_behalf_of, starts.on_behalf_of) AS on_behalf_of,
        coalesce(if(act.is_begun, own.seq, NULL), done.seq) AS begun_seq
    FROM execution_finished AS done
    ANTI JOIN actions_under_way AS earlier ON done.run_id = earlier.run_id AND done.action_id = earlier.action_id
    ASOF LEFT JOIN execution_started AS starts
        ON done.run_id = starts.run_id AND done.action_id = starts.action_id AND done.seq > starts.seq
    ASOF LEFT JOIN execution_started AS own
        ON done.run_id = own.run_id AND done.action_id = own.action_id AND done.robot = own.robot AND done.seq > own.seq
    ASOF LEFT JOIN turns AS act
        ON done.run_id = act.run_id AND done.action_id = act.action_id AND done.robot = act.robot AND done.seq > act.seq
),

steps AS (
    SELECT DISTINCT run_id, action_id
    FROM step_began
),

progress AS (
    SELECT run_id, seq, task_id, type = 'TaskAbandoned.v1' AS is_given_up
    FROM task_events
    WHERE type IN ('StepBegan.v1', 'StepCompleted.v1', 'TaskCompleted.v1', 'TaskAbandoned.v1')
),

ends AS (
    -- An action that is no step of a task, such as a request on a robot's own initiative, has no step waiting for it.
    SELECT
        done.run_id, done.seq, done.time_us, done.action_id, done.requested_by, done.executed_by, done.supervised_by,
        done.robot, done.began_by, done.begun_seq, done.on_behalf_of,
        CASE WHEN steps.run_id IS NOT NULL THEN later.seq END AS next_seq,
        CASE WHEN steps.run_id IS NOT NULL THEN later.is_given_up END AS is_given_up
    FROM finished AS done
    LEFT JOIN steps ON done.run_id = steps.run_id AND done.action_id = steps.action_id
    ASOF LEFT JOIN progress AS later
        ON done.run_id = later.run_id AND done.task_id = later.task_id AND done.seq < later.seq
    -- The robot on whose behalf it began may be unknown.
    WHERE done.robot <> done.on_behalf_of OR done.robot IS DISTINCT FROM done.began_by
)

SELECT
    run_id, seq, time_us,
    'ExecutionFinished.v1' AS type,
    action_id, requested_by, executed_by, supervised_by, robot, began_by, begun_seq, on_behalf_of, next_seq, is_given_up
FROM ends
UNION ALL
SELECT
    run_id, seq, time_us, 'ExecutionStarted.v1' AS type, action_id, requested_by, executed_by, supervised_by, robot,
    robot AS began_by, seq AS begun_seq, on_behalf_of,
    NULL AS next_seq,
    NULL AS is_given_up
FROM execution_started AS starts
ANTI JOIN actions_under_way AS earlier ON starts.run_id = earlier.run_id AND starts.action_id = earlier.action_id
WHERE robot <> on_behalf_of
