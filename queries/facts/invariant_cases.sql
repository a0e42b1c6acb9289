-- Title: How many cases each invariant checked
-- Paper: sec:model:invariants, sec:architecture:invariants
-- Grain: one row per run and invariant that found anything to judge
-- Key: run_id, invariant
-- Units: cases records, decisions, executions or acts of recovery, each judged by the invariant; never fewer than the
--   events that offend it
-- NULL: never; without a row there was nothing to judge, which is no pass
-- Example: fsar-ledger query facts/invariant_cases LEDGER
-- Stored: audit reads it for each invariant
WITH counted AS (
    SELECT
        run_id,
        count(*) FILTER (
            type = 'RobotJoined.v1' OR len(path) > 0
            OR coalesce(decided_by, requested_by, executed_by, supervised_by, claimant, sender, receiver) IS NOT NULL
        ) AS i1,
        count(*) FILTER (type = 'ExecutionStarted.v1' AND NOT coalesce(robot = on_behalf_of, FALSE)) AS i2,
        count(*) FILTER (
            type IN ('OwnStepDecided.v1', 'RoutinePerformed.v1', 'RoutineWithheld.v1')
            OR (type = 'ExecutionStarted.v1' AND robot = on_behalf_of)
        ) AS a1,
        count(*) FILTER (
            executed_by IS NOT NULL OR robot = 'coordinator' OR starts_with(robot, 'service/')
            OR (robot IS NOT NULL AND regexp_matches(type, '^(Execution|Assistance|RoutinePerformed)'))
        ) AS a2,
        count(*) FILTER (type = 'RequestAdmitted.v1') AS a3,
        count(*) FILTER (
            type IN (
                'OwnStepDecided.v1', 'RoutinePerformed.v1', 'RoutineWithheld.v1', 'RequestAdmitted.v1',
                'AssistanceAdmitted.v1', 'RequestAccepted.v1', 'ReplanOrdered.v1'
            )
            OR (type = 'ExecutionHeld.v1' AND len(path) > 0)
        ) AS a4,
        count(*) FILTER (type = 'AssistanceAdmitted.v1') AS a5
    FROM event_principals
    GROUP BY run_id
),

judged AS (
    SELECT
        run_id,
        unnest([
            'i1_local_agent_coherence', 'i2_local_execution_ownership', 'a1_local_runtime_self_sufficiency',
            'a2_coordination_only_federation', 'a3_no_silent_policy_override', 'a4_thin_federation_interface',
            'a5_audit_completeness'
        ]) AS invariant,
        unnest([i1, i2, a1, a2, a3, a4, a5]) AS cases
    FROM counted
    UNION ALL
    SELECT run_id, 'a4_thin_federation_interface' AS invariant, 1 AS cases
    FROM recovery_attempted
    WHERE level = 'local'
    UNION ALL
    SELECT run_id, 'i2_local_execution_ownership' AS invariant, 1 AS cases
    FROM rights_at_evaluations
    WHERE verdict = 'admitted'
    UNION ALL
    SELECT run_id, unnest(['i3_jointly_composed_policy', 'a3_no_silent_policy_override']) AS invariant, 1 AS cases
    FROM known_policy
    UNION ALL
    SELECT run_id, 'a3_no_silent_policy_override' AS invariant, 1 AS cases
    FROM mandate_conflicts
    UNION ALL
    SELECT run_id, 'i4_outward_recovery' AS invariant, 1 AS cases
    FROM recovery_acts
    UNION ALL
    SELECT events.run_id, 'i5_audit_attributability' AS invariant, 1 AS cases
    FROM event_principals AS events
    INNER JOIN event_classes AS classes ON events.type = classes.type
    WHERE classes.record_kind IS NOT NULL -- each is a row of coordination_events
    UNION ALL
    SELECT run_id, 'a5_audit_completeness' AS invariant, 1 AS cases
    FROM cross_robot_records
)

SELECT run_id, invariant, sum(cases)::BIGINT AS cases
FROM judged
GROUP BY run_id, invariant
HAVING sum(cases) > 0
