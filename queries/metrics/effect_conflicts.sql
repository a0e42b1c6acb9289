-- Title: Conflicts of effect
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per run
-- Key: run_id
-- Units: numerator and value actions that a body began to serve while it served another, a body's own motions while it
--   served one, and works that two or more bodies did at once, each counted once; denominator 1 (the run);
--   *_without_routine the same without those motions, which are routine operations
-- NULL: numbers where the run does not observe what the metric rests on; not_observed where it does
-- Example: fsar-ledger query metrics/effect_conflicts LEDGER
-- An occupation without a recorded end has no duration here, so that a system that records only starts is not charged.
-- Claims of authority do not matter here: where no principal claims any, the paper's count of conflicts is 0.
-- Partial: the rows of a run do not depend on other runs
WITH swept AS (
    -- Ordered by beginning, each occupation beside the earlier one that lasts longest, of its body and of its work.
    SELECT
        run_id, seq, robot, action_id, work, began_us,
        max(ended_us) OVER of_body AS busy_until_us,
        arg_max(action_id, ended_us) OVER of_body AS busy_with,
        max(ended_us) OVER of_work AS done_until_us,
        arg_max(robot, ended_us) OVER of_work AS done_by
    FROM occupations
    WINDOW
        of_body AS (
            PARTITION BY run_id, robot
            ORDER BY seq ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
        ),
        of_work AS (
            PARTITION BY run_id, work
            ORDER BY seq ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
        )
),

clashes AS (
    SELECT DISTINCT
        run_id, robot, action_id,
        CASE WHEN action_id IS NULL THEN seq END AS motion
    FROM swept
    WHERE busy_until_us > began_us AND busy_with IS DISTINCT FROM action_id
    UNION ALL
    SELECT DISTINCT
        run_id,
        NULL AS robot,
        work AS action_id,
        NULL AS motion
    FROM swept
    WHERE work IS NOT NULL AND done_until_us > began_us AND done_by <> robot
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
