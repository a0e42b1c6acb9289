-- Title: Denials: who asked, who denied, when, why, under which windows or rules, and who supervised
-- Paper: eq:admissible, eq:policy, sec:model:request
-- Grain: one row per RequestDenied event
-- Key: run_id, seq
-- Units: denied_s seconds of run time; seq, under_seqs positions in the run, for `prove RUN:SEQ`; robot matches the
--   requester, the denier or the robot that was asked, itself or through one of its agents
-- NULL: asked_by when no record of the action names who asked; any other principal that the record does not name;
--   action_id when neither the record nor its cause names one; denied_under, under_seqs (the names and positions of the
--   windows and rules, side by side) when none on record explains the denial, as where the ends of windows are not
--   recorded
-- `grounds_of_denials` lists when each window or rule held, and whose policy it was.
-- Example: fsar-ledger query audit/denials LEDGER --param run=RUN
--   answers A1-1/3.1 at 31.046 s: denied by robot/B1 for policy, under window local/B1/0, supervised by supervisor/B1
-- Parameters: run: run = all, action: action = all, robot: robot = all
SELECT
    denials.run_id, denials.seq,
    denials.time_us / 1000000 AS denied_s,
    denials.action_id,
    coalesce(denials.requested_by, actions.asked_by) AS asked_by,
    denials.executed_by AS asked_of,
    denials.decided_by AS denied_by,
    denials.reason, denials.denied_under, denials.under_seqs, denials.supervised_by
FROM denied_actions AS denials
LEFT JOIN action_records AS actions
    ON denials.run_id = actions.run_id AND denials.action_id = actions.action_id
WHERE
    $run IN ('all', denials.run_id) AND $action IN ('all', denials.action_id)
    AND $robot IN (
        'all', denials.requested_by, actions.asked_by, denials.executed_by,
        'robot/' || regexp_extract(denials.decided_by, '^(?:robot|agent)/([^/]+)', 1)
    )
