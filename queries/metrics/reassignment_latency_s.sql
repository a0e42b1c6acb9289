-- Title: Reassignment latency
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator microseconds from detection to local resolution or to leaving the first level; denominator failures
--   that did either; value seconds
-- NULL: value of a run without such failures; numbers where the run does not observe what the metric rests on;
--   not_observed where it does
-- Example: fsar-ledger query metrics/reassignment_latency_s LEDGER
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        run_id,
        count(latency_us) AS denominator,
        sum(latency_us) AS numerator
    FROM failures
    GROUP BY run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN judged.numerator::BIGINT / nullif(judged.denominator, 0) / 1000000 END
        AS value,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'reassignment_latency_s'
