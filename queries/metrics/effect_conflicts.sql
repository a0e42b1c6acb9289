-- Title: Conflicts of effect
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per run
-- Key: run_id
-- Units: numerator and value bodies set in motion for an action, or by themselves, while they served another, and
--   bodies set in motion for an action that another body served; denominator 1 (the run); *_without_routine the same
--   without motions of a body by itself, which are routine operations
-- NULL: numbers of a run that does not observe what the metric rests on; not_observed of one that does
-- Example: fsar-ledger query metrics/effect_conflicts LEDGER
-- Whether anybody claimed authority does not matter: where nobody claims, the paper's count of conflicts is 0.
WITH clashes AS (
    SELECT DISTINCT later.run_id, later.seq, later.action_id
    FROM occupations AS later
    INNER JOIN occupations AS earlier
        ON
            later.run_id = earlier.run_id AND later.robot = earlier.robot AND later.seq > earlier.seq
            AND earlier.action_id IS DISTINCT FROM later.action_id
            AND later.began_us < coalesce(earlier.ended_us, later.began_us + 1)
    UNION
    SELECT DISTINCT later.run_id, later.seq, later.action_id
    FROM occupations AS later
    INNER JOIN occupations AS earlier
        ON
            later.run_id = earlier.run_id AND later.action_id = earlier.action_id AND later.seq > earlier.seq
            AND later.robot <> earlier.robot
            AND later.began_us < coalesce(earlier.ended_us, later.began_us + 1)
),

judged AS (
    SELECT
        run_id,
        count(*) AS numerator,
        count(action_id) AS numerator_without_routine
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
