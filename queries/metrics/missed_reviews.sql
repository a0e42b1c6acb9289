-- Title: Interventions that were needed but not requested
-- Paper: sec:evaluation:metrics (human intervention)
-- Grain: one row per run
-- Key: run_id
-- Units: numerator and value executions and motions that started where the true policy asked for a review and no
--   supervisor had approved them; denominator 1 (the run); *_without_routine the same without motions, which serve no
--   action and cannot be approved
-- NULL: numbers where the run does not observe what the metric rests on; not_observed where it does
-- Example: fsar-ledger query metrics/missed_reviews LEDGER
-- A fleet without supervisors calls none, so its human intervention is 0; this counts the reviews it misses.
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        run_id,
        count(*) AS numerator,
        count(action_id) AS numerator_without_routine
    FROM governed_starts
    WHERE outcome = 'review' AND NOT is_approved
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
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'missed_reviews'
