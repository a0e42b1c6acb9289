-- Title: Coordination success
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator tasks completed within their budget; denominator tasks; value share
-- NULL: value of a run without tasks; numbers where the run does not observe what the metric rests on; not_observed
--   where it does
-- Example: fsar-ledger query metrics/coordination_success LEDGER
-- Partial: the rows of a run do not depend on other runs
WITH completions AS (
    SELECT
        run_id, task_id,
        min(time_us) AS completed_us
    FROM task_completed
    GROUP BY run_id, task_id
),

tasks AS (
    SELECT
        arrived.run_id,
        count(*) AS denominator,
        count(*) FILTER (WHERE completions.completed_us - arrived.time_us <= arrived.budget_us) AS numerator
    FROM task_arrived AS arrived
    LEFT JOIN completions ON arrived.run_id = completions.run_id AND arrived.task_id = completions.task_id
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
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'coordination_success'
