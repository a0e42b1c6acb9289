-- Title: Recovery containment
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator failures resolved at local or peer level; denominator failures; value share
-- NULL: value of a run without failures; an unresolved failure is not contained; numbers where the run does not observe
--   what the metric rests on; not_observed where it does
-- Example: fsar-ledger query metrics/recovery_containment LEDGER
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        run_id,
        count(*) AS denominator,
        count(*) FILTER (WHERE is_contained) AS numerator
    FROM failures
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
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'recovery_containment'
