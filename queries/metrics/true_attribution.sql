-- Title: True attribution
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per run
-- Key: run_id
-- Units: numerator executions whose record names who asked, who acted and, where one was on shift, a supervisor of the
--   robot; denominator executions; value share
-- NULL: value of a run without executions; numbers where the run does not observe what the metric rests on;
--   not_observed where it does
-- Example: fsar-ledger query metrics/true_attribution LEDGER
-- facts/true_principals has each field.
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        run_id,
        count(*) AS denominator,
        count(*) FILTER (
            origin_is_named AND executor_is_named AND coalesce(supervisor_is_named, TRUE)
        ) AS numerator
    FROM true_principals
    GROUP BY run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN judged.numerator / nullif(judged.denominator, 0) END AS value,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'true_attribution'
