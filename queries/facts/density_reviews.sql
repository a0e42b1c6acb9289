-- Title: Reviews due by the density of supervision regardless of policy, in the form of facts/policy_grounds
-- Paper: eq:supervision, sec:model:supervision
-- Grain: one row per event of facts/policies_seen at which the robot's next admission was due for review
-- Key: run_id, seq
-- Units: opened_us, seen_us microseconds of run time; seq, ground_seq positions in the run; review_every admissions
-- NULL: window_name, scope, capability, context, closed_us, which a density does not have
-- Example: fsar-ledger query facts/density_reviews LEDGER
WITH densities AS (
    -- A density set for the robot takes precedence over the one for every robot.
    SELECT
        policies.run_id, policies.seq, policies.decided_seq, policies.robot, policies.decided_us,
        arg_max(sets.seq, (sets.robot IS NOT NULL, sets.seq)) AS ground_seq,
        arg_max(sets.time_us, (sets.robot IS NOT NULL, sets.seq)) AS opened_us,
        arg_max(sets.review_every, (sets.robot IS NOT NULL, sets.seq)) AS review_every
    FROM policies_seen AS policies
    INNER JOIN supervision_density_set AS sets
        ON
            policies.run_id = sets.run_id AND policies.decided_seq > sets.seq
            AND coalesce(sets.robot, policies.robot) = policies.robot
    WHERE policies.outcome = 'review' AND policies.reason = 'review'
    GROUP BY policies.run_id, policies.seq, policies.decided_seq, policies.robot, policies.decided_us
)

SELECT
    densities.run_id, densities.seq, densities.ground_seq,
    NULL::VARCHAR AS window_name,
    densities.robot,
    NULL::VARCHAR AS scope,
    NULL::VARCHAR AS capability,
    NULL::VARCHAR AS context,
    'review' AS outcome,
    densities.opened_us,
    NULL::BIGINT AS closed_us,
    densities.decided_us AS seen_us,
    densities.review_every
FROM densities
LEFT JOIN request_admitted AS admitted
    ON
        densities.run_id = admitted.run_id AND densities.robot = admitted.executed_by
        AND densities.decided_seq > admitted.seq
WHERE densities.review_every > 0
GROUP BY ALL
HAVING (count(admitted.seq) + 1) % any_value(densities.review_every) = 0
