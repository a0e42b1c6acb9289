-- Title: Requests: who asked, allowed, denied (under which window or rule), executed and supervised, and the result;
--   also own steps that failed or were denied
-- Paper: eq:request, eq:auth, sec:model:invariants (I5)
-- Grain: one row per action meant for another robot, per attempt of an outsider, per own action with a failure or a
--   denial, and per action named by the parameter
-- Key: run_id, action_id
-- Units: began_s, denied_s (the last denial), ended_s seconds of run time; failures, denials count; denied_seq (the
--   last denial), seq (what decided the result) positions in the run, for `prove RUN:SEQ`; is_request marks actions
--   meant for another robot and attempts of outsiders, so that `count_if(is_request)` counts requests
-- NULL: a principal that the record does not name; capability when the record of the action names none; denied_s,
--   denied_seq without a denial; denied_under when no window or rule on record explains one; ended_s when the record
--   shows no end; seq while the result is undecided. Where nothing is on record, NULL if the run does not observe it:
--   denials without request, knowledge and supervision, failures without recovery, result without request, execution
--   and registry
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
)

SELECT
    actions.run_id,
    actions.began_us / 1000000 AS began_s,
    actions.action_id, actions.capability, actions.asked_by, actions.allowed_by,
    denials.denied_by,
    denials.denied_us / 1000000 AS denied_s,
    nullif(array_to_string(denials.denied_under, ' and '), '') AS denied_under,
    denials.denied_seq,
    if(
        list_has_all(runs.observes, ['request', 'knowledge', 'supervision']),
        coalesce(denials.denials, 0),
        denials.denials
    ) AS denials,
    actions.executed_by,
    nullif(array_to_string(list_sort(list_distinct(actions.supervisors)), ' and '), '') AS supervised_by,
    actions.failures,
    CASE
        WHEN actions.result IS NOT NULL THEN actions.result
        WHEN actions.refused_seq IS NULL THEN actions.state
        WHEN actions.refusal = 'nobody to ask' AND actions.offered_seq < actions.refused_seq THEN 'no answer'
        -- It may still have begun, and there may have been candidates.
        WHEN NOT list_contains(runs.observes, 'execution') THEN NULL
        WHEN actions.refusal = 'nobody to ask' AND NOT list_contains(runs.observes, 'registry') THEN NULL
        ELSE actions.refusal
    END AS result,
    coalesce(actions.ended_us, actions.withdrawn_us) / 1000000 AS ended_s,
    CASE
        WHEN actions.result IS NOT NULL THEN actions.result_seq
        WHEN actions.refused_seq IS NULL THEN if(actions.state = 'withdrawn', actions.withdrawn_seq, NULL)
        ELSE actions.refused_seq
    END AS seq,
    actions.is_request
FROM action_records AS actions
INNER JOIN runs ON actions.run_id = runs.run_id
LEFT JOIN denials ON actions.run_id = denials.run_id AND actions.action_id = denials.action_id
WHERE
    $run IN ('all', actions.run_id) AND $action IN ('all', actions.action_id)
    AND (actions.is_request OR actions.failures > 0 OR denials.denials > 0 OR $action = actions.action_id)
