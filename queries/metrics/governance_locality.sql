-- Title: Governance locality
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator decisions that a robot or named supervisor took by itself; denominator decisions; value share
-- NULL: value of a run without decisions; numbers of a run that does not observe what the metric rests on; not_observed of one that does
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
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN judged.numerator / nullif(judged.denominator, 0) END AS value,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'governance_locality'
