-- Title: The windows and rules under which requests were denied: whose policy each was, when it held, and when the
--   decider had last seen it
-- Paper: eq:policy, eq:admissible, app:foundations
-- Grain: one row per RequestDenied event, policy window or rule under which it fell, and robot whose policy that was
-- Key: run_id, seq, under_seq, policy_of
-- Units: denied_s, opened_s, closed_s seconds of run time; opened_s to closed_s half-open; seen_s when the denier had
--   last seen the policy, or, for a policy that the request carried, its sender; seq, under_seq positions in the run,
--   for `prove RUN:SEQ`
-- NULL: denied_by when the record does not name it; action_id when neither the record nor its cause names one; closed_s
--   when it was never closed; seen_s when the run does not observe knowledge; no row for a denial that no window or
--   rule on record explains
-- A denial can rest on a policy that was already over (was_open FALSE): a planner and the coordinator decide by an old
-- copy, and a request carries what its sender saw.
-- Example: fsar-ledger query audit/grounds_of_denials LEDGER --param run=RUN
--   answers A1-1/3.1 at 31.046 s: denied by robot/B1 under window local/B1/0 of its local policy, open
-- Parameters: run: run = all, action: action = all
SELECT
    denials.run_id, denials.seq,
    denials.time_us / 1000000 AS denied_s,
    denials.action_id,
    denials.decided_by AS denied_by,
    denials.reason,
    coalesce(grounds.window_name, 'rule ' || grounds.ground_seq) AS denied_under,
    grounds.ground_seq AS under_seq,
    grounds.scope,
    grounds.robot AS policy_of,
    grounds.outcome,
    grounds.opened_us / 1000000 AS opened_s,
    grounds.closed_us / 1000000 AS closed_s,
    if(list_contains(runs.observes, 'knowledge'), grounds.seen_us / 1000000, NULL) AS seen_s,
    coalesce(grounds.closed_us > denials.time_us, TRUE) AS was_open
FROM denied_actions AS denials
INNER JOIN policy_grounds AS grounds ON denials.run_id = grounds.run_id AND denials.seq = grounds.seq
LEFT JOIN runs ON denials.run_id = runs.run_id
WHERE $run IN ('all', denials.run_id) AND $action IN ('all', denials.action_id)
