-- Title: How many cases each invariant checked
-- Paper: sec:model:invariants, sec:architecture:invariants
-- Grain: one row per run and invariant that found anything to judge
-- Key: run_id, invariant
-- Units: cases records, decisions, executions or acts of recovery, each judged by the invariant; never fewer than the
--   events that offend it
-- NULL: never; without a row there was nothing to judge, which is no pass
-- Example: fsar-ledger query facts/invariant_cases LEDGER
-- Stored: audit reads it for each invariant
WITH judged AS (
    SELECT
        run_id,
        unnest(list_concat([
            CASE
                WHEN
                    type = 'RobotJoined.v1' OR len(path) > 0
                    OR coalesce(
                        decided_by, requested_by, executed_by, supervised_by, claimant, sender, receiver
                    ) IS NOT NULL
                    THEN 'i1_local_agent_coherence'
            END,
            CASE
                WHEN
                    executed_by IS NOT NULL OR robot = 'coordinator' OR starts_with(robot, 'service/')
                    OR (robot IS NOT NULL AND regexp_matches(type, '^(Execution|Assistance|RoutinePerformed)'))
                    THEN 'a2_coordination_only_federation'
            END
        ], CASE
            WHEN type IN ('OwnStepDecided.v1', 'RoutinePerformed.v1', 'RoutineWithheld.v1')
                THEN ['a1_local_runtime_self_sufficiency', 'a4_thin_federation_interface']
            WHEN type = 'RequestAdmitted.v1' THEN ['a3_no_silent_policy_override', 'a4_thin_federation_interface']
            WHEN type = 'AssistanceAdmitted.v1' THEN ['a4_thin_federation_interface', 'a5_audit_completeness']
            WHEN type = 'ExecutionStarted.v1'
                THEN [if(robot = on_behalf_of, 'a1_local_runtime_self_sufficiency', 'i2_local_execution_ownership')]
            WHEN type IN ('RequestAccepted.v1', 'ReplanOrdered.v1') OR (type = 'ExecutionHeld.v1' AND len(path) > 0)
                THEN ['a4_thin_federation_interface']
        END)) AS invariant
    FROM event_principals
    -- Each of these events has a robot or a path, which may be empty; leaving others out costs less than judging them.
    WHERE
        robot IS NOT NULL OR decided_by IS NOT NULL OR requested_by IS NOT NULL OR executed_by IS NOT NULL
        OR supervised_by IS NOT NULL
        OR claimant IS NOT NULL OR sender IS NOT NULL OR receiver IS NOT NULL OR path IS NOT NULL
    UNION ALL
    SELECT run_id, 'a4_thin_federation_interface' AS invariant
    FROM recovery_attempted
    WHERE level = 'local'
    UNION ALL
    SELECT run_id, 'i2_local_execution_ownership' AS invariant
    FROM rights_at_evaluations
    WHERE verdict = 'admitted'
    UNION ALL
    SELECT run_id, unnest(['i3_jointly_composed_policy', 'a3_no_silent_policy_override']) AS invariant
    FROM known_policy
    UNION ALL
    SELECT run_id, 'a3_no_silent_policy_override' AS invariant
    FROM mandate_conflicts
    UNION ALL
    SELECT run_id, 'i4_outward_recovery' AS invariant
    FROM recovery_acts
    UNION ALL
    SELECT events.run_id, 'i5_audit_attributability' AS invariant
    FROM event_principals AS events
    INNER JOIN event_classes AS classes ON events.type = classes.type
    WHERE classes.record_kind IS NOT NULL -- each is a row of coordination_events
    UNION ALL
    SELECT run_id, 'a5_audit_completeness' AS invariant
    FROM cross_robot_records
)

SELECT run_id, invariant, count(*) AS cases
FROM judged
WHERE invariant IS NOT NULL
GROUP BY run_id, invariant
