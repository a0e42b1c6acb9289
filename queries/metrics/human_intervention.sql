-- Title: Human intervention
-- Paper: sec:evaluation:metrics
-- Grain: one row per run
-- Units: numerator and value 1 if the fleet supervisor was called, else 0; denominator 1 (the run)
-- NULL: never
-- Example: fsar-ledger query metrics/human_intervention LEDGER
WITH judged AS (
    SELECT
        run_id,
        1 AS numerator
    FROM supervisor_called
    WHERE supervisor = 'supervisor/fleet'
    GROUP BY run_id
)

SELECT
    runs.run_id,
    coalesce(judged.numerator, 0)::BIGINT AS numerator,
    1::BIGINT AS denominator,
    coalesce(judged.numerator, 0)::DOUBLE AS value
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
