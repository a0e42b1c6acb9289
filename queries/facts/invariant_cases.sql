-- Title: How many cases each invariant checked
-- Paper: sec:model:invariants, sec:architecture:invariants
-- Grain: one row per run and invariant with at least one case
-- Key: run_id, invariant
-- Units: cases records, decisions, executions or acts of recovery; never fewer than the events that break the invariant
-- NULL: never; without a row there was nothing to judge, which is no pass
-- Example: fsar-ledger query facts/invariant_cases LEDGER
-- Stored: each invariant of an audit reads it
-- Partial: the rows of a run do not depend on other runs
WITH of_types AS ( -- conditions on the type alone are evaluated once per type
    SELECT
        run_id, type,
        count(*) AS events, count(*) FILTER (names_somebody) AS naming, count(*) FILTER (robot = on_behalf_of) AS own,
        count(*) FILTER (type = 'ExecutionHeld.v1' AND len(path) > 0) AS held_on_path,
        count(*) FILTER (executed_by IS NOT NULL OR robot IS NOT NULL) AS placed,
        count(*) FILTER (executed_by IS NOT NULL OR robot = 'coordinator' OR starts_with(robot, 'service/')) AS central
    FROM naming_events
    GROUP BY run_id, type
),

counted AS (
    SELECT
        of_types.run_id,
        sum(if(of_types.type = 'RobotJoined.v1', events, naming)) AS i1,
        sum(events - own) FILTER (of_types.type = 'ExecutionStarted.v1') AS i2,
        sum(events) FILTER (classes.record_kind IS NOT NULL) AS i5, -- each is a row of coordination_events
        sum(if(of_types.type = 'ExecutionStarted.v1', own, events)) FILTER (
            of_types.type IN ('OwnStepDecided.v1', 'RoutinePerformed.v1', 'RoutineWithheld.v1', 'ExecutionStarted.v1')
        ) AS a1,
        sum(if(regexp_matches(of_types.type, '^(Execution|Assistance|RoutinePerformed)'), placed, central)) AS a2,
        sum(events) FILTER (of_types.type = 'RequestAdmitted.v1') AS a3,
        sum(if(of_types.type = 'ExecutionHeld.v1', held_on_path, events)) FILTER (
            of_types.type IN (
                'OwnStepDecided.v1', 'RoutinePerformed.v1', 'RoutineWithheld.v1', 'RequestAdmitted.v1',
                'AssistanceAdmitted.v1', 'RequestAccepted.v1', 'ReplanOrdered.v1', 'ExecutionHeld.v1'
            )
        ) AS a4,
        sum(events) FILTER (of_types.type = 'AssistanceAdmitted.v1') AS a5
    FROM of_types
    LEFT JOIN event_classes AS classes ON of_types.type = classes.type
    GROUP BY of_types.run_id
),

judged AS (
    SELECT
        run_id,
        unnest([
            'i1_local_agent_coherence', 'i2_local_execution_ownership', 'i5_audit_attributability',
            'a1_local_runtime_self_sufficiency', 'a2_coordination_only_federation', 'a3_no_silent_policy_override',
            'a4_thin_federation_interface', 'a5_audit_completeness'
        ]) AS invariant,
        unnest([i1, i2, i5, a1, a2, a3, a4, a5]) AS cases
    FROM counted
    UNION ALL
    SELECT run_id, 'a4_thin_federation_interface' AS invariant, (level = 'local')::INT AS cases FROM recovery_attempted
    UNION ALL -- not judged, since their requests came before the record
    SELECT run_id, 'i2_local_execution_ownership' AS invariant, -starts_for_others AS cases FROM actions_under_way
    UNION ALL
    SELECT run_id, 'a1_local_runtime_self_sufficiency' AS invariant, -own_starts AS cases FROM actions_under_way
    UNION ALL
    SELECT run_id, 'i2_local_execution_ownership' AS invariant, (verdict = 'admitted')::INTEGER AS cases
    FROM rights_at_evaluations
    UNION ALL
    SELECT run_id, unnest(['i3_jointly_composed_policy', 'a3_no_silent_policy_override']) AS invariant, 1 AS cases
    FROM known_policy
    UNION ALL
    SELECT run_id, 'a3_no_silent_policy_override' AS invariant, 1 AS cases FROM mandate_conflicts
    UNION ALL
    SELECT run_id, 'i4_outward_recovery' AS invariant, 1 AS cases FROM recovery_acts
    UNION ALL
    SELECT run_id, 'a5_audit_completeness' AS invariant, 1 AS cases FROM cross_robot_records
)

SELECT run_id, invariant, sum(cases)::BIGINT AS cases
FROM judged
GROUP BY run_id, invariant
HAVING sum(cases) > 0
