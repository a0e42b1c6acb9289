-- Title: Policy violations
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator and value executions and motions that started against policy; denominator 1 (the run)
-- NULL: never
-- Example: fsar-ledger query metrics/policy_violations LEDGER
WITH judged AS (
    SELECT
        run_id,
        count(*) FILTER (WHERE is_violation) AS numerator
    FROM governed_starts
    GROUP BY run_id
)

SELECT
    runs.run_id,
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    1::BIGINT AS denominator,
    coalesce(judged.numerator, 0)::DOUBLE AS value
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
