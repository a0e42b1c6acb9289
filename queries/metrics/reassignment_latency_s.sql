-- Title: Reassignment latency
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator microseconds from detection to local resolution or to leaving the first level; denominator failures that did either; value seconds
-- NULL: value of a run without such failures
-- Example: fsar-ledger query metrics/reassignment_latency_s LEDGER
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
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    coalesce(judged.denominator, 0)::BIGINT AS denominator,
    judged.numerator::BIGINT / nullif(judged.denominator, 0) / 1000000 AS value
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
