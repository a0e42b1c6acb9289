-- Title: Denials: who asked, who denied, when, why, under which window or rule, and who supervised
-- Paper: eq:admissible, eq:policy, sec:model:request
-- Grain: one row per RequestDenied event and policy window or rule under which it fell; one for a denial that none
--   explains
-- Key: run_id, seq, under_seq?
-- Units: ground counts the windows and rules of one denial from 1, so that rows with ground 1 count denials; denied_s,
--   opened_s, closed_s seconds of run time; opened_s to closed_s half-open; seen_s when whoever denied, or for what the
--   request carried its sender, had last seen the policy; seq, under_seq positions in the run, for `prove RUN:SEQ`;
--   robot: who asked, was asked or denied, itself or by an agent of its own
-- NULL: asked_by when no record of the action names who asked; any other principal that the record does not name;
--   action_id when neither the record nor its cause names one; what is said about the window or rule when no record
--   explains the denial; closed_s when it was never closed
-- A denial can rest on what was over by then (was_open FALSE): a planner and the coordinator decide by an old copy, and
-- a request carries what its sender saw.
-- Example: fsar-ledger query audit/denials LEDGER --param run=RUN
--   answers A1-1/3.1 at 31.046 s: denied by robot/B1 for policy, under window local/B1/0, supervised by supervisor/B1
-- Parameters: run: run = all, action: action = all, robot: robot = all
SELECT
    denials.run_id, denials.seq,
    row_number() OVER (PARTITION BY denials.run_id, denials.seq ORDER BY grounds.ground_seq) AS ground,
    denials.time_us / 1000000 AS denied_s,
    denials.action_id,
    coalesce(denials.requested_by, actions.asked_by) AS asked_by,
    denials.executed_by AS asked_of,
    denials.decided_by AS denied_by,
    denials.reason,
    coalesce(grounds."window", 'rule ' || grounds.ground_seq) AS denied_under,
    grounds.ground_seq AS under_seq,
    grounds.scope,
    grounds.robot AS policy_of,
    grounds.outcome,
    grounds.opened_us / 1000000 AS opened_s,
    grounds.closed_us / 1000000 AS closed_s,
    grounds.seen_us / 1000000 AS seen_s,
    CASE WHEN grounds.ground_seq IS NOT NULL THEN coalesce(grounds.closed_us > denials.time_us, TRUE) END AS was_open,
    denials.supervised_by
FROM denied_actions AS denials
LEFT JOIN policy_grounds AS grounds ON denials.run_id = grounds.run_id AND denials.seq = grounds.seq
LEFT JOIN action_records AS actions
    ON denials.run_id = actions.run_id AND denials.action_id = actions.action_id
WHERE
    $run IN ('all', denials.run_id) AND $action IN ('all', denials.action_id)
    AND $robot IN (
        'all', denials.requested_by, actions.asked_by, denials.executed_by,
        'robot/' || split_part(denials.decided_by, '/', 2)
    )
