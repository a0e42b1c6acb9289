-- Title: What a record leaves open, so that a metric cannot count it
-- Paper: sec:evaluation:metrics
-- Grain: one row per run of another system and judge that its open records affect
-- Key: run_id, judge
-- Units: none
-- NULL: never; hides_offences is whether apparent offences may be none
-- Example: fsar-ledger query facts/censored LEDGER
WITH foreign_runs AS (
    SELECT run_id FROM runs
    WHERE kind = 'foreign'
),

meanings (what, not_observed, judges) AS (
    VALUES
    ('open task', 'the end of what was open', ['coordination_success', 'success_without_violation']),
    (
        'open failure', 'the end of what was open',
        ['recovery_containment', 'reassignment_latency_s', 'time_to_know_s']
    ),
    ('task', 'which task was completed', ['coordination_success', 'success_without_violation']),
    ('budget', 'TaskArrived.budget_us', ['coordination_success', 'success_without_violation']),
    ('failure', 'which failure was resolved', ['recovery_containment', 'reassignment_latency_s', 'time_to_know_s']),
    ('supervisor', 'who supervises the fleet', ['human_intervention']),
    (
        'window', 'the policy before the record',
        [
            'policy_violations', 'success_without_violation', 'i3_jointly_composed_policy',
            'a3_no_silent_policy_override'
        ]
    ),
    ('claim', 'who held authority before the record', ['authority_conflicts']),
    (
        'absence', 'who was off shift before the record',
        ['audit_attributability', 'i5_audit_attributability', 'a5_audit_completeness', 'true_attribution']
    ),
    (
        'supervisor before', 'who supervised a robot before it joined again',
        ['audit_attributability', 'i5_audit_attributability', 'a5_audit_completeness', 'true_attribution']
    )
),

left_open AS (
    SELECT run_id, unnest(if(open_tasks > 0, ['open task'], []) || if(open_failures > 0, ['open failure'], [])) AS what
    FROM open_work
    SEMI JOIN foreign_runs ON open_work.run_id = foreign_runs.run_id
    UNION ALL
    -- Two arrivals may be one task or two; one completed before it arrived is another; without a budget none is late.
    SELECT arrived.run_id, if(count(*) > count(arrived.budget_us), 'budget', 'task') AS what
    FROM task_arrived AS arrived
    SEMI JOIN foreign_runs ON arrived.run_id = foreign_runs.run_id
    LEFT JOIN task_completed AS done ON arrived.run_id = done.run_id AND arrived.task_id = done.task_id
    GROUP BY arrived.run_id, arrived.task_id
    HAVING what = 'budget' OR count(DISTINCT arrived.seq) > 1 OR min(done.time_us) < min(arrived.time_us)
    UNION ALL
    -- Two failures with the same number may be one failure or two.
    SELECT run_id, 'failure' AS what
    FROM execution_failed AS failed
    SEMI JOIN foreign_runs ON failed.run_id = foreign_runs.run_id
    GROUP BY run_id, action_id, failure
    HAVING count(*) > 1
    UNION ALL
    -- A supervisor of no robot may be the fleet's. One call that names the fleet's supervisor decides the metric.
    SELECT called.run_id, 'supervisor' AS what
    FROM supervisor_called AS called
    SEMI JOIN foreign_runs ON called.run_id = foreign_runs.run_id
    ANTI JOIN fleet_members AS members ON called.run_id = members.run_id AND called.supervisor = members.supervisor
    ANTI JOIN fleet_calls AS calls ON called.run_id = calls.run_id
    UNION ALL
    SELECT run_id, if(what = 'supervisor', 'supervisor before', what) AS what
    FROM begun_before
)

SELECT
    left_open.run_id, judged.judge,
    string_agg(DISTINCT meanings.not_observed, ', ' ORDER BY meanings.not_observed) AS not_observed,
    bool_or(left_open.what IN ('absence', 'supervisor before')) AS hides_offences
FROM left_open
INNER JOIN meanings ON left_open.what = meanings.what
CROSS JOIN unnest(meanings.judges) AS judged (judge)
GROUP BY left_open.run_id, judged.judge
