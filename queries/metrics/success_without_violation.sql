-- Title: Success without any violation
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator tasks completed within their budget for which nothing started against policy; denominator tasks;
--   value share
-- NULL: value of a run without tasks; numbers where the run does not observe what the metric rests on; not_observed
--   where it does
-- Example: fsar-ledger query metrics/success_without_violation LEDGER
-- The true policy counts, at every start, wherever it was checked, so that an architecture that checks less gains
-- nothing.
-- Partial: the rows of a run do not depend on other runs
WITH completions AS (
    SELECT
        run_id, task_id,
        min(time_us) AS completed_us
    FROM task_completed
    GROUP BY run_id, task_id
),

violated AS (
    SELECT DISTINCT starts.run_id, executions.task_id
    FROM governed_starts AS starts
    INNER JOIN executions ON starts.run_id = executions.run_id AND starts.seq = executions.seq
    WHERE starts.is_violation
),

tasks AS (
    SELECT
        arrived.run_id,
        count(*) AS denominator,
        count(*) FILTER (
            violated.task_id IS NULL AND completions.completed_us - arrived.time_us <= arrived.budget_us
        ) AS numerator
    FROM task_arrived AS arrived
    LEFT JOIN completions ON arrived.run_id = completions.run_id AND arrived.task_id = completions.task_id
    LEFT JOIN violated ON arrived.run_id = violated.run_id AND arrived.task_id = violated.task_id
    GROUP BY arrived.run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(tasks.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(tasks.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN tasks.numerator / nullif(tasks.denominator, 0) END AS value,
    hidden.not_observed
FROM runs
LEFT JOIN tasks ON runs.run_id = tasks.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'success_without_violation'
