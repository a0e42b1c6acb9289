-- Title: An action that starts against policy more than once is one violation
-- Paper: sec:evaluation:metrics
-- Reading: R7
-- Question: how often one action can violate policy
-- Replaces: policy_violations
-- Moves: policy_violations
-- Why: The number of actions per run, not of their starts.
-- Grain: one row per run
-- Key: run_id
-- Units: as in policy_violations
-- NULL: as in policy_violations
-- Example: fsar-ledger query readings/violation_of_action LEDGER
WITH judged AS (
    SELECT
        run_id,
        count(*) FILTER (WHERE is_violation AND action_id IS NULL) AS motions,
        count(DISTINCT action_id) FILTER (WHERE is_violation) AS actions
    FROM governed_starts
    GROUP BY run_id
)

SELECT
    measured.* REPLACE (
        CASE WHEN measured.not_observed IS NULL THEN coalesce(judged.motions + judged.actions, 0)::BIGINT END
            AS numerator,
        CASE WHEN measured.not_observed IS NULL THEN coalesce(judged.motions + judged.actions, 0)::DOUBLE END AS value,
        CASE WHEN measured.not_observed IS NULL THEN coalesce(judged.actions, 0)::BIGINT END
            AS numerator_without_routine,
        CASE WHEN measured.not_observed IS NULL THEN coalesce(judged.actions, 0)::DOUBLE END AS value_without_routine
    )
FROM policy_violations AS measured
LEFT JOIN judged ON measured.run_id = judged.run_id
