-- Title: Conflicts of effect
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per run
-- Key: run_id
-- Units: numerator and value two actions that a body served at once, motions of a body by itself while it served one,
--   and works that two bodies or more did at once, each counted once; denominator 1 (the run); *_without_routine the
--   same without those motions, which are routine operations
-- NULL: numbers of a run that does not observe what the metric rests on; not_observed of one that does
-- Example: fsar-ledger query metrics/effect_conflicts LEDGER
-- Whether anybody claimed authority does not matter: where nobody claims, the paper's count of conflicts is 0.
WITH clashes AS (
    SELECT DISTINCT
        later.run_id, later.robot,
        least(earlier.action_id, later.action_id) AS one,
        greatest(earlier.action_id, later.action_id) AS other,
        CASE WHEN later.action_id IS NULL THEN later.seq END AS motion
    FROM occupations AS later
    INNER JOIN occupations AS earlier
        ON
            later.run_id = earlier.run_id AND later.robot = earlier.robot AND later.seq > earlier.seq
            AND earlier.action_id IS DISTINCT FROM later.action_id
            AND later.began_us < coalesce(earlier.ended_us, later.began_us + 1)
    UNION ALL
    SELECT DISTINCT
        later.run_id,
        NULL AS robot,
        later.work AS one,
        NULL AS other,
        NULL AS motion
    FROM occupations AS later
    INNER JOIN occupations AS earlier
        ON
            later.run_id = earlier.run_id AND later.work = earlier.work AND later.seq > earlier.seq
            AND later.robot <> earlier.robot
            AND later.began_us < coalesce(earlier.ended_us, later.began_us + 1)
),

judged AS (
    SELECT
        run_id,
        count(*) AS numerator,
        count(*) FILTER (WHERE motion IS NULL) AS numerator_without_routine
    FROM clashes
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
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'effect_conflicts'
