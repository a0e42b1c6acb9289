-- Title: Policy violations
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator and value executions and motions that started against policy; denominator 1 (the run);
--        *_without_routine the same without motions, which are routine operations (R42)
-- NULL: numbers where the run does not observe what the metric rests on; not_observed where it does
-- Example: fsar-ledger query metrics/policy_violations LEDGER
-- Partial: the rows of a run do not depend on other runs
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
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN 1::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::DOUBLE END AS value,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator_without_routine, 0)::BIGINT END
        AS numerator_without_routine,
    CASE WHEN hidden.run_id IS NULL THEN 1::BIGINT END AS denominator_without_routine,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator_without_routine, 0)::DOUBLE END
        AS value_without_routine,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'policy_violations'
