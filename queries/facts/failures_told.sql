-- Title: How long only its robot knew of each failure
-- Paper: sec:model:recovery
-- Grain: one row per ExecutionFailed event
-- Key: run_id, seq
-- Units: known_us microseconds of run time when another principal decides something about the action, a supervisor is
--   called, or a robot that was asked to help has heard of it; passed_us when the task goes on or is given up;
--   run_ended_us the time of the last record of a task, a request, recovery or supervision
-- NULL: known_us where no other principal is recorded as knowing; passed_us where the task did neither
-- Example: fsar-ledger query facts/failures_told LEDGER
WITH records AS (
    SELECT
        run_id, seq, time_us, type,
        coalesce(failed_action, action_id) AS action_id,
        decided_by,
        CASE WHEN type <> 'AssistanceRequested.v1' THEN helper END AS helper
    FROM recovery_events
    UNION ALL BY NAME
    SELECT run_id, seq, time_us, type, action_id, decided_by
    FROM supervision_events
    UNION ALL BY NAME
    SELECT run_id, seq, time_us, type, action_id, decided_by
    FROM request_events
),

told AS (
    SELECT
        failures.run_id, failures.seq,
        min(records.time_us) AS known_us
    FROM failures
    INNER JOIN records
        ON
            failures.run_id = records.run_id AND failures.action_id = records.action_id
            AND failures.seq < records.seq
    WHERE
        records.type = 'SupervisorCalled.v1'
        OR records.helper <> failures.robot
        OR (
            records.decided_by <> failures.robot
            AND NOT starts_with(records.decided_by, replace(failures.robot, 'robot/', 'agent/') || '/')
        )
    GROUP BY failures.run_id, failures.seq
),

passed AS (
    SELECT
        failures.run_id, failures.seq,
        min(tasks.time_us) AS passed_us
    FROM failures
    INNER JOIN task_events AS tasks
        ON failures.run_id = tasks.run_id AND failures.task_id = tasks.task_id AND failures.seq < tasks.seq
    WHERE tasks.type IN ('StepCompleted.v1', 'TaskCompleted.v1', 'TaskAbandoned.v1')
    GROUP BY failures.run_id, failures.seq
),

ends AS (
    SELECT
        run_id,
        max(time_us) AS ended_us
    FROM (
        SELECT run_id, time_us
        FROM records
        UNION ALL
        SELECT run_id, time_us
        FROM task_events
    ) AS every_record
    GROUP BY run_id
)

SELECT failures.run_id, failures.seq, told.known_us, passed.passed_us, ends.ended_us AS run_ended_us
FROM failures
INNER JOIN ends ON failures.run_id = ends.run_id
LEFT JOIN told ON failures.run_id = told.run_id AND failures.seq = told.seq
LEFT JOIN passed ON failures.run_id = passed.run_id AND failures.seq = passed.seq
