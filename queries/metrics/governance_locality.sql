-- Title: Governance locality
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator decisions that a robot or named supervisor took by itself; denominator decisions; value share
-- NULL: value of a run without decisions
-- Example: fsar-ledger query metrics/governance_locality LEDGER
WITH judged AS (
    SELECT
        run_id,
        count(*) AS denominator,
        count(*) FILTER (WHERE is_local) AS numerator
    FROM decisions
    GROUP BY run_id
)

SELECT
    runs.run_id,
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    coalesce(judged.denominator, 0)::BIGINT AS denominator,
    judged.numerator / nullif(judged.denominator, 0) AS value
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
