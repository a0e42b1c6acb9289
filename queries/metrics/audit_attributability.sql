-- Title: Audit attributability
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator coordination events whose origin, executor and supervisor are recorded or recoverable; denominator coordination events; value share
-- NULL: value of a run without coordination events
-- Example: fsar-ledger query metrics/audit_attributability LEDGER
WITH judged AS (
    SELECT
        run_id,
        count(*) AS denominator,
        count(*) FILTER (WHERE is_attributable) AS numerator
    FROM coordination_events
    GROUP BY run_id
)

SELECT
    runs.run_id,
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    coalesce(judged.denominator, 0)::BIGINT AS denominator,
    judged.numerator / nullif(judged.denominator, 0) AS value
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
