-- Title: Governance locality
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Key: run_id
-- Units: numerator decisions that a robot or named supervisor took by itself; denominator decisions; value share;
--        *_without_routine the same without decisions on routine operations, which no request made (R42)
-- NULL: value of a run without decisions; numbers where the run does not observe what the metric rests on; not_observed
--   where it does
-- Example: fsar-ledger query metrics/governance_locality LEDGER
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        run_id,
        count(*) AS denominator,
        count(*) FILTER (WHERE is_local) AS numerator,
        count(*) FILTER (WHERE decision_kind <> 'routine') AS denominator_without_routine,
        count(*) FILTER (WHERE is_local AND decision_kind <> 'routine') AS numerator_without_routine
    FROM decisions
    GROUP BY run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN judged.numerator / nullif(judged.denominator, 0) END AS value,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator_without_routine, 0)::BIGINT END
        AS numerator_without_routine,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator_without_routine, 0)::BIGINT END
        AS denominator_without_routine,
    CASE
        WHEN hidden.run_id IS NULL THEN judged.numerator_without_routine / nullif(judged.denominator_without_routine, 0)
    END AS value_without_routine,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'governance_locality'
