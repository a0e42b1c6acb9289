-- Title: The record of each action: who asked, allowed, acted and supervised, and the result
-- Paper: eq:request, eq:auth, sec:model:invariants (I5)
-- Grain: one row per action that a record names, or that a denial is about by its cause
-- Key: run_id, action_id
-- Units: began_us, ended_us, withdrawn_us microseconds of run time; begun_seq the last command, acceptance, queueing or
--   start; refused_seq, result_seq the last refusal, result after it; withdrawn_seq the last withdrawal; offered_seq
--   the first query with candidates
-- NULL: values that no record of the action gives; failures when none is on record and the run does not observe
--   recovery, state when it does not observe execution and request; withdrawn_us unless the state is withdrawn
-- Example: fsar-ledger query facts/action_records LEDGER
-- Stored: requests, interventions and denials read it
WITH records AS (
    SELECT
        told.run_id, told.action_id, told.seq, time_us, type, capability, candidates, target_role, decided_by,
        requested_by, executed_by, supervised_by, robot, purpose, approves, result, cause, reason, failure,
        events.type IN ('ExecutionStarted.v1', 'ExecutionFinished.v1') AS is_deed, -- a record may begin between them
        max(told.seq) FILTER (
            events.type IN ('CommandIssued.v1', 'RequestAccepted.v1', 'ExecutionQueued.v1', 'ExecutionStarted.v1')
        ) OVER of_action AS begun_seq,
        any_value(events.robot) FILTER (events.type = 'StepBegan.v1') OVER of_action AS acting,
        told.seq > coalesce(begun_seq, -1) AS is_last, -- an action that begins again is not over
        -- An action that an isolated robot failed to complete is still to be done.
        is_last AND events.type IN ('ExecutionFinished.v1', 'RequestClosed.v1')
        OR (is_last AND events.type = 'IsolatedResultAccepted.v1' AND events.result = 'success') AS is_end,
        is_last AND events.type IN ('RequestDenied.v1', 'RequestUnanswered.v1') AS is_refusal,
        -- An answer about a request that was closed meanwhile allows nothing.
        coalesce(
            arg_max(events.type, told.seq) FILTER (
                events.type IN ('RequestIssued.v1', 'SupervisorCalled.v1', 'RequestClosed.v1')
            ) OVER (PARTITION BY told.run_id, told.action_id ORDER BY told.seq) <> 'RequestClosed.v1',
            TRUE
        ) AS is_open
    FROM action_events AS told
    INNER JOIN events ON told.run_id = events.run_id AND told.seq = events.seq
    WINDOW of_action AS (PARTITION BY told.run_id, told.action_id)
)

SELECT
    records.run_id, records.action_id,
    min(time_us) AS began_us, arg_min(capability, seq) AS capability,
    coalesce(
        arg_min(decided_by, seq) FILTER (type IN ('RequestIssued.v1', 'CommandIssued.v1', 'OwnStepDecided.v1')),
        arg_min(requested_by, seq), arg_min(robot, seq) FILTER (type = 'OutsiderRequestInjected.v1')
    ) AS asked_by,
    string_agg(DISTINCT decided_by, ' and ' ORDER BY decided_by) FILTER (
        type IN ('RequestAdmitted.v1', 'CommandIssued.v1', 'OwnStepDecided.v1')
        OR (type = 'SupervisorResponded.v1' AND purpose = 'review' AND approves AND is_open)
    ) AS allowed_by,
    string_agg(DISTINCT executed_by, ' and ' ORDER BY executed_by) FILTER (is_deed) AS executed_by,
    list(coalesce(if(type = 'SupervisorResponded.v1', decided_by, NULL), supervised_by) ORDER BY seq) FILTER (
        is_deed OR type IN ('RequestDenied.v1', 'SupervisorResponded.v1')
    ) AS supervisors,
    nullif(
        greatest(count(*) FILTER (type = 'ExecutionFailed.v1'), count(DISTINCT failure)),
        if(any_value(list_contains(runs.observes, 'recovery')), NULL, 0)
    ) AS failures,
    coalesce(max(time_us) FILTER (is_end), max(time_us) FILTER (is_refusal)) AS ended_us,
    any_value(begun_seq) AS begun_seq, max(seq) FILTER (is_refusal) AS refused_seq,
    max(seq) FILTER (is_end AND result IS NOT NULL) AS result_seq,
    arg_max(result || coalesce('(' || cause || ')', ''), seq) FILTER (is_end) AS result,
    arg_max(
        if(type = 'RequestDenied.v1', 'denied: ' || reason, if(executed_by IS NULL, 'nobody to ask', 'no answer')), seq
    ) FILTER (is_refusal) AS refusal,
    max(seq) FILTER (type = 'ExecutionWithdrawn.v1') AS withdrawn_seq,
    CASE
        WHEN NOT any_value(list_has_all(runs.observes, ['execution', 'request'])) THEN NULL
        WHEN bool_or(type IN ('ExecutionStarted.v1', 'ExecutionResumed.v1', 'ExecutionPaused.v1') OR failure > 0)
            THEN 'not finished' -- a record may begin while an action is under way
        ELSE if(bool_or(is_last AND type = 'ExecutionWithdrawn.v1'), 'withdrawn', 'not begun')
    END AS state,
    if(state = 'withdrawn', max(time_us) FILTER (type = 'ExecutionWithdrawn.v1'), NULL) AS withdrawn_us,
    min(seq) FILTER (type = 'RegistryQueried.v1' AND len(candidates) > 0) AS offered_seq, bool_or(
        target_role IS NOT NULL
        OR type IN ('RequestIssued.v1', 'RegistryQueried.v1', 'OutsiderRequestInjected.v1')
        OR (type = 'CommandIssued.v1' AND robot IS DISTINCT FROM acting) -- a master commands a robot's own steps, too
    )
    AND NOT bool_or(type = 'OwnStepDecided.v1') AS is_request -- a failed step of one's own asks the registry for help
FROM records
INNER JOIN runs ON records.run_id = runs.run_id
GROUP BY records.run_id, records.action_id
