-- Title: What a record leaves open, so that a metric cannot count it
-- Paper: sec:evaluation:metrics
-- Grain: one row per run of another system and judge of what is open in it
-- Key: run_id, judge
-- Units: none
-- NULL: never; hides_offences tells whether what would be an offence may be none
-- Example: fsar-ledger query facts/censored LEDGER
WITH foreign_runs AS (
    SELECT run_id
    FROM runs
    WHERE kind = 'foreign'
),

mixed_up AS (
    -- What arrives twice may be one task or two, and what was completed before it arrived another one.
    SELECT arrived.run_id, arrived.task_id
    FROM task_arrived AS arrived
    INNER JOIN foreign_runs ON arrived.run_id = foreign_runs.run_id
    LEFT JOIN task_completed AS done ON arrived.run_id = done.run_id AND arrived.task_id = done.task_id
    GROUP BY arrived.run_id, arrived.task_id
    HAVING count(DISTINCT arrived.seq) > 1 OR min(done.time_us) < min(arrived.time_us)
),

strangers AS (
    -- Who supervises no robot may supervise the fleet. One call that names the fleet's supervisor decides the metric.
    SELECT DISTINCT called.run_id
    FROM supervisor_called AS called
    INNER JOIN foreign_runs ON called.run_id = foreign_runs.run_id
    ANTI JOIN fleet_members AS members ON called.run_id = members.run_id AND called.supervisor = members.supervisor
    ANTI JOIN fleet_calls AS calls ON called.run_id = calls.run_id
),

left_open AS (
    SELECT
        run_id, 'the end of what was open' AS what,
        if(open_tasks > 0, ['coordination_success', 'success_without_violation'], [])
        || if(open_failures > 0, ['recovery_containment', 'reassignment_latency_s', 'time_to_know_s'], []) AS judges
    FROM open_work
    SEMI JOIN foreign_runs ON open_work.run_id = foreign_runs.run_id
    UNION ALL
    SELECT run_id, 'which task was completed' AS what, ['coordination_success', 'success_without_violation'] AS judges
    FROM mixed_up
    UNION ALL
    SELECT run_id, 'who supervises the fleet' AS what, ['human_intervention'] AS judges
    FROM strangers
    UNION ALL
    SELECT
        run_id, 'the policy before the record' AS what,
        [
            'policy_violations', 'success_without_violation', 'i3_jointly_composed_policy',
            'a3_no_silent_policy_override'
        ] AS judges
    FROM begun_before
    WHERE what = 'window'
    UNION ALL
    SELECT
        run_id, 'who was off shift before the record' AS what,
        ['audit_attributability', 'i5_audit_attributability', 'a5_audit_completeness'] AS judges
    FROM begun_before
    WHERE what = 'absence'
),

judged AS (
    SELECT run_id, what, unnest(judges) AS judge
    FROM left_open
)

SELECT
    run_id, judge,
    string_agg(DISTINCT what, ', ' ORDER BY what) AS not_observed,
    bool_or(what = 'who was off shift before the record') AS hides_offences
FROM judged
GROUP BY run_id, judge
