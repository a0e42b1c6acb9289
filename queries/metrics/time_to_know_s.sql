-- Title: How long a failure is its robot's alone
-- Paper: sec:model:recovery
-- Grain: one row per run
-- Key: run_id
-- Units: numerator microseconds from detection until another principal decides something about the action or a
--   supervisor is called, or until the failure is resolved or the task goes on or is given up, or else until the run
--   ends; denominator failures; value seconds
-- NULL: value of a run without failures; numbers of a run that does not observe what the metric rests on; not_observed
--   of one that does
-- Example: fsar-ledger query metrics/time_to_know_s LEDGER
-- A failure of which nobody hears is contained and calls nobody; here it lasts.
WITH records AS (
    SELECT
        run_id, seq, time_us, type,
        coalesce(failed_action, action_id) AS action_id,
        decided_by
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
    FROM event_principals
    GROUP BY run_id
),

judged AS (
    SELECT
        failures.run_id,
        count(*) AS denominator,
        sum(
            coalesce(least(told.known_us, failures.resolved_us, passed.passed_us), ends.ended_us) - failures.detected_us
        )::BIGINT AS numerator
    FROM failures
    INNER JOIN ends ON failures.run_id = ends.run_id
    LEFT JOIN told ON failures.run_id = told.run_id AND failures.seq = told.seq
    LEFT JOIN passed ON failures.run_id = passed.run_id AND failures.seq = passed.seq
    GROUP BY failures.run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN judged.numerator / nullif(judged.denominator, 0) / 1000000 END AS value,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'time_to_know_s'
