-- Title: Requests: who asked, who allowed, who executed, who supervised, and what came of it; and own steps that failed
-- Paper: eq:request, eq:auth, sec:model:invariants (I5)
-- Grain: one row per action that another robot was to do, per attempt of an outsider, per own action with a failure,
--   and per action that the call names
-- Key: run_id, action_id
-- Units: began_s, ended_s seconds of run time; failures count
-- NULL: a principal that the record does not name; capability when the record of the action names none; ended_s when
--   the record shows no end
-- Example: fsar-ledger query audit/requests LEDGER --param run=RUN
--   answers A1-1/2.1 door.open.basic: asked by robot/A1, allowed by robot/B1, executed by robot/B1, supervised by
--   supervisor/B1: success
-- Parameters: run: run = all, action: action = all
WITH told AS (
    SELECT run_id, seq, action_id
    FROM keyed_events
    WHERE action_id IS NOT NULL AND $run IN ('all', run_id) AND $action IN ('all', action_id)
    UNION ALL
    SELECT run_id, seq, action_id
    FROM competing_calls
    WHERE $run IN ('all', run_id) AND $action IN ('all', action_id)
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
        string_agg(
            DISTINCT coalesce(decided_by, supervised_by), ' and ' ORDER BY coalesce(decided_by, supervised_by)
        ) FILTER (
            (type = 'ExecutionStarted.v1' AND supervised_by IS NOT NULL) OR type = 'SupervisorResponded.v1'
        ) AS supervised_by,
        count(*) FILTER (type = 'ExecutionFailed.v1') AS failures,
        max(time_us) FILTER (
            type IN ('ExecutionFinished.v1', 'RequestClosed.v1', 'RequestDenied.v1', 'RequestUnanswered.v1')
        ) AS ended_us,
        coalesce(
            arg_max(result, events.seq) FILTER (type IN ('ExecutionFinished.v1', 'RequestClosed.v1')),
            arg_max(
                CASE
                    WHEN type = 'RequestDenied.v1' THEN 'denied: ' || reason
                    WHEN executed_by IS NULL THEN 'nobody to ask'
                    ELSE 'no answer'
                END,
                events.seq
            ) FILTER (type IN ('RequestDenied.v1', 'RequestUnanswered.v1')),
            CASE WHEN count(*) FILTER (type = 'ExecutionStarted.v1') > 0 THEN 'not finished' ELSE 'not begun' END
        ) AS result,
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
    run_id,
    began_us / 1000000 AS began_s,
    action_id, capability, asked_by, allowed_by, executed_by, supervised_by, failures,
    if(result = 'nobody to ask' AND is_offered, 'no answer', result) AS result,
    ended_us / 1000000 AS ended_s
FROM actions
WHERE is_request OR failures > 0 OR $action = action_id
