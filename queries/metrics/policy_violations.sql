-- Title: Policy violations
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator and value executions and motions that started against policy; denominator 1 (the run);
--        *_without_routine the same without motions, which are routine operations (R42)
-- NULL: never
-- Example: fsar-ledger query metrics/policy_violations LEDGER
WITH judged AS (
    SELECT
        run_id,
        count(*) FILTER (WHERE is_violation) AS numerator,
        count(*) FILTER (WHERE is_violation AND action_id IS NOT NULL) AS numerator_without_routine
    FROM governed_starts
    GROUP BY run_id
)

SELECT
    runs.run_id,
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    1::BIGINT AS denominator,
    coalesce(judged.numerator, 0)::DOUBLE AS value,
    coalesce(judged.numerator_without_routine, 0)::BIGINT AS numerator_without_routine,
    1::BIGINT AS denominator_without_routine,
    coalesce(judged.numerator_without_routine, 0)::DOUBLE AS value_without_routine
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
