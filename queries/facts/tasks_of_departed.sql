-- Title: Tasks hit by a departure: an action for them was cut off, or no robot was there to act
-- Paper: sec:discussion:heterogeneity
-- Grain: one row per task with a request that ended as failure(departed), or with an execution, a recovery or a help
--   that a departure ended, or that was given up while a robot of one of its steps was away after a departure; where
--   its steps are not on record, the robot that received it, or one that has executed for it
-- Key: run_id, task_id
-- Units: hit_seq, ended_seq positions in the run
-- NULL: hit_seq where only the giving up is on record; ended_seq, outcome of a task that is open at the end
-- Example: fsar-ledger query facts/tasks_of_departed LEDGER
WITH cut_off AS (
    SELECT run_id, task_id, min(seq) AS hit_seq
    FROM (
        SELECT run_id, task_id, seq FROM request_closed
        WHERE result = 'failure' AND cause = 'departed'
        UNION ALL
        SELECT run_id, task_id, seq FROM execution_failed
        WHERE cause = 'departed'
        UNION ALL
        SELECT run_id, task_id, seq FROM recovery_escalated
        WHERE reason = 'departed'
        UNION ALL
        SELECT run_id, task_id, seq FROM assistance_failed
        WHERE cause = 'departed'
    ) AS causes
    GROUP BY run_id, task_id
),

acting AS (
    SELECT DISTINCT run_id, task_id, 'robot/' || split_part(unnest(steps), ' ', 1) || team AS robot FROM task_arrived
    UNION
    SELECT arrived.run_id, arrived.task_id, unnest([arrived.robot, starts.robot]) AS robot
    FROM task_arrived AS arrived
    LEFT JOIN execution_started AS starts ON arrived.run_id = starts.run_id AND arrived.task_id = starts.task_id
    WHERE coalesce(len(arrived.steps), 0) = 0
),

ends AS (
    -- A record of another system may end a task twice: the last end counts.
    SELECT run_id, task_id, max(seq) AS seq, arg_max(outcome, seq) AS outcome
    FROM (
        SELECT run_id, task_id, seq, 'completed' AS outcome FROM task_completed
        UNION ALL
        SELECT run_id, task_id, seq, 'abandoned' AS outcome FROM task_abandoned
    ) AS told
    GROUP BY run_id, task_id
),

waited AS (
    SELECT DISTINCT ends.run_id, ends.task_id
    FROM ends
    INNER JOIN acting ON ends.run_id = acting.run_id AND ends.task_id = acting.task_id
    INNER JOIN departed_robots AS gone ON acting.run_id = gone.run_id AND acting.robot = gone.robot
    WHERE ends.outcome = 'abandoned' AND ends.seq > gone.since_seq AND ends.seq < coalesce(gone.until_seq, ends.seq + 1)
),

arrived AS (
    SELECT DISTINCT run_id, task_id FROM task_arrived
),

hit AS (
    SELECT run_id, task_id FROM cut_off
    UNION
    SELECT run_id, task_id FROM waited
)

SELECT
    hit.run_id, hit.task_id, cut_off.hit_seq, ends.seq AS ended_seq, ends.outcome
FROM hit
INNER JOIN arrived ON hit.run_id = arrived.run_id AND hit.task_id = arrived.task_id
LEFT JOIN cut_off ON hit.run_id = cut_off.run_id AND hit.task_id = cut_off.task_id
LEFT JOIN ends ON hit.run_id = ends.run_id AND hit.task_id = ends.task_id
