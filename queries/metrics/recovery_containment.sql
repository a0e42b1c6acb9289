-- Title: Recovery containment
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator failures resolved at local or peer level; denominator failures; value share
-- NULL: value of a run without failures; an unresolved failure is not contained
-- Example: fsar-ledger query metrics/recovery_containment LEDGER
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
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    coalesce(judged.denominator, 0)::BIGINT AS denominator,
    judged.numerator / nullif(judged.denominator, 0) AS value
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
