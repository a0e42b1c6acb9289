-- Title: The true requester, executor and supervisor of each execution, compared with its record
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per ExecutionStarted event
-- Key: run_id, seq
-- Units: origin_is_named, executor_is_named, supervisor_is_named whether the record names the true one
-- NULL: supervisor_is_named where no supervisor of the robot's own was on shift; action_id, task_id as in executions
-- Example: fsar-ledger query facts/true_principals LEDGER
-- Robot and on_behalf_of are physical facts. H_F may stand for the robot's own supervisor, whichever that is.
WITH on_shift AS (
    SELECT executions.run_id, executions.seq, members.supervisor
    FROM executions
    INNER JOIN fleet_members AS members
        ON executions.run_id = members.run_id AND executions.robot = members.robot
    LEFT JOIN supervisor_absences AS absences
        ON
            members.run_id = absences.run_id AND members.supervisor = absences.supervisor
            AND executions.seq > absences.left_seq
            AND executions.seq < coalesce(absences.returned_seq, executions.seq + 1)
    WHERE members.supervisor IS NOT NULL AND absences.run_id IS NULL
)

SELECT
    executions.run_id, executions.seq, executions.task_id, executions.action_id,
    coalesce(records.requested_by = executions.on_behalf_of, FALSE) AS origin_is_named,
    coalesce(records.executed_by = executions.robot, FALSE) AS executor_is_named,
    CASE
        WHEN on_shift.seq IS NOT NULL
            THEN coalesce(records.supervised_by IN (on_shift.supervisor, 'supervisor/fleet'), FALSE)
    END AS supervisor_is_named
FROM executions
INNER JOIN event_principals AS records ON executions.run_id = records.run_id AND executions.seq = records.seq
LEFT JOIN on_shift ON executions.run_id = on_shift.run_id AND executions.seq = on_shift.seq
