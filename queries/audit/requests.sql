-- Title: Requests: who asked, who allowed, who denied and under which window or rule, who executed, who supervised, and
--   what came of it; and own steps that failed or were denied
-- Paper: eq:request, eq:auth, sec:model:invariants (I5)
-- Grain: one row per action that another robot was to do, per attempt of an outsider, per own action with a failure or
--   a denial, and per action that the call names
-- Key: run_id, action_id
-- Units: began_s, denied_s (the last denial), ended_s seconds of run time; failures, denials count; denied_seq (the
--   last denial), seq (what decided the result) positions in the run, for `prove RUN:SEQ`
-- NULL: a principal that the record does not name; capability when the record of the action names none; denied_s,
--   denied_seq without a denial; denied_under when no window or rule on record explains one; ended_s when the record
--   shows no end; seq while nothing has decided the result
-- Example: fsar-ledger query audit/requests LEDGER --param run=RUN
--   answers A1-1/2.1 door.open.basic: asked by robot/A1, allowed by robot/B1, executed by robot/B1, supervised by
--   supervisor/B1: success
-- Parameters: run: run = all, action: action = all
WITH denied AS (
    SELECT run_id, seq, time_us, action_id, decided_by, denied_under
    FROM denied_actions
    WHERE action_id IS NOT NULL AND $run IN ('all', run_id) AND $action IN ('all', action_id)
),

denials AS (
    SELECT
        run_id, action_id,
        string_agg(DISTINCT decided_by, ' and ' ORDER BY decided_by) AS denied_by,
        list_sort(list_distinct(flatten(list(denied_under)))) AS denied_under,
        max(time_us) AS denied_us,
        max(seq) AS denied_seq,
        count(*) AS denials
    FROM denied
    GROUP BY run_id, action_id
),

told AS (
    SELECT run_id, seq, action_id
    FROM keyed_events
    WHERE action_id IS NOT NULL AND $run IN ('all', run_id) AND $action IN ('all', action_id)
    UNION ALL
    SELECT run_id, seq, action_id
    FROM competing_calls
    WHERE $run IN ('all', run_id) AND $action IN ('all', action_id)
    UNION ALL
    SELECT run_id, seq, action_id
    FROM denied
),

actions AS (
    SELECT
        told.run_id, told.action_id,
        min(time_us) AS began_us,
        arg_min(capability, events.seq) AS capability,
        coalesce(
            arg_min(decided_by, events.seq) FILTER (
                type IN ('RequestIssued.v1', 'CommandIssued.v1', 'OwnStepDecided.v1')
            ),
            arg_min(requested_by, events.seq), arg_min(robot, events.seq) FILTER (type = 'OutsiderRequestInjected.v1')
        ) AS asked_by,
        string_agg(DISTINCT decided_by, ' and ' ORDER BY decided_by) FILTER (
            type IN ('RequestAdmitted.v1', 'CommandIssued.v1', 'OwnStepDecided.v1')
            OR (type = 'SupervisorResponded.v1' AND purpose = 'review' AND approves)
        ) AS allowed_by,
        string_agg(DISTINCT executed_by, ' and ' ORDER BY executed_by) FILTER (type = 'ExecutionStarted.v1')
            AS executed_by,
        list(coalesce(if(type = 'SupervisorResponded.v1', decided_by, NULL), supervised_by)) FILTER (
            type IN ('ExecutionStarted.v1', 'RequestDenied.v1', 'SupervisorResponded.v1')
        ) AS supervisors,
        count(*) FILTER (type = 'ExecutionFailed.v1') AS failures,
        max(time_us) FILTER (
            type IN ('ExecutionFinished.v1', 'RequestClosed.v1', 'RequestDenied.v1', 'RequestUnanswered.v1')
        ) AS ended_us,
        max(events.seq) FILTER (type IN ('CommandIssued.v1', 'ExecutionStarted.v1')) AS begun_seq,
        max(events.seq) FILTER (type IN ('RequestDenied.v1', 'RequestUnanswered.v1')) AS refused_seq,
        max(events.seq) FILTER (
            type IN ('ExecutionFinished.v1', 'RequestClosed.v1') AND result IS NOT NULL
        ) AS result_seq,
        arg_max(result, events.seq) FILTER (type IN ('ExecutionFinished.v1', 'RequestClosed.v1')) AS result,
        arg_max(
            CASE
                WHEN type = 'RequestDenied.v1' THEN 'denied: ' || reason
                WHEN executed_by IS NULL THEN 'nobody to ask'
                ELSE 'no answer'
            END,
            events.seq
        ) FILTER (type IN ('RequestDenied.v1', 'RequestUnanswered.v1')) AS refusal,
        if(count(*) FILTER (type = 'ExecutionStarted.v1') > 0, 'not finished', 'not begun') AS state,
        coalesce(max(len(candidates)) FILTER (type = 'RegistryQueried.v1'), 0) > 0 AS is_offered,
        count(*) FILTER (
            target_role IS NOT NULL
            OR type IN ('RequestIssued.v1', 'CommandIssued.v1', 'RegistryQueried.v1', 'OutsiderRequestInjected.v1')
        ) > 0 AS is_request
    FROM told
    INNER JOIN events ON told.run_id = events.run_id AND told.seq = events.seq
    GROUP BY told.run_id, told.action_id
)

SELECT
    actions.run_id,
    actions.began_us / 1000000 AS began_s,
    actions.action_id, actions.capability, actions.asked_by, actions.allowed_by,
    denials.denied_by,
    denials.denied_us / 1000000 AS denied_s,
    nullif(array_to_string(denials.denied_under, ' and '), '') AS denied_under,
    denials.denied_seq,
    coalesce(denials.denials, 0) AS denials,
    actions.executed_by,
    nullif(array_to_string(list_sort(list_distinct(actions.supervisors)), ' and '), '') AS supervised_by,
    actions.failures,
    CASE
        WHEN actions.result IS NOT NULL THEN actions.result
        WHEN actions.refused_seq IS NULL OR actions.begun_seq > actions.refused_seq THEN actions.state
        WHEN actions.refusal = 'nobody to ask' AND actions.is_offered THEN 'no answer'
        ELSE actions.refusal
    END AS result,
    actions.ended_us / 1000000 AS ended_s,
    CASE
        WHEN actions.result IS NOT NULL THEN actions.result_seq
        WHEN actions.begun_seq > actions.refused_seq THEN NULL
        ELSE actions.refused_seq
    END AS seq
FROM actions
LEFT JOIN denials ON actions.run_id = denials.run_id AND actions.action_id = denials.action_id
WHERE actions.is_request OR actions.failures > 0 OR denials.denials > 0 OR $action = actions.action_id
