-- Title: Authority conflicts
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator and value conflicts (one per action and dimension); denominator 1 (the run)
-- NULL: numbers where the run does not observe what the metric rests on; not_observed where it does
-- Example: fsar-ledger query metrics/authority_conflicts LEDGER
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        run_id,
        count(*) AS numerator
    FROM conflicts
    GROUP BY run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN 1::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::DOUBLE END AS value,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'authority_conflicts'
