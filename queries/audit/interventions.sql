-- Title: Human interventions: each call of the fleet supervisor, when, in which run, for what, and what was decided
-- Paper: sec:evaluation:metrics (human intervention), eq:supervision
-- Grain: one row per SupervisorCalled event for H_F, which human_intervention counts; that metric is the share of runs
--   with at least one
-- Key: run_id, seq
-- Units: called_s, decided_s seconds of run time; seq (the call), decided_seq (the answer), under_seqs (the windows and
--   rules) positions in the run, for `prove RUN:SEQ`
-- NULL: action_id and the columns about it when the call is about no action; decided_by, decision, decided_s,
--   decided_seq when no answer to the call is on record; capability, asked_by when no record of the action names one;
--   called_under, under_seqs when it is for no review, or no window or rule on record explains it
-- Example: fsar-ledger query audit/interventions LEDGER --param run=RUN
--   answers a call for review of A1-2/4.1 door.open.secure at 78.287 s, which supervisor/fleet approved at
--   137.865 s
-- Parameters: run: run = all
WITH firsts AS (
    SELECT run_id, called_seq, min(seq) AS seq
    FROM answered_calls
    GROUP BY run_id, called_seq
)

SELECT
    calls.run_id, calls.seq,
    calls.time_us / 1000000 AS called_s,
    calls.supervisor AS called,
    calls.purpose, calls.action_id, actions.capability, actions.asked_by,
    grounds.told AS called_under,
    grounds.ground_seqs AS under_seqs,
    answers.decided_by,
    CASE
        WHEN answers.preferred IS NOT NULL THEN answers.preferred || ' first'
        WHEN NOT answers.approves THEN 'refused'
        WHEN answers.approves
            THEN CASE calls.purpose WHEN 'review' THEN 'approved' WHEN 'recovery' THEN 'resolved' ELSE 'ordered' END
    END AS decision,
    answers.time_us / 1000000 AS decided_s,
    answers.seq AS decided_seq
FROM fleet_calls AS calls
LEFT JOIN firsts ON calls.run_id = firsts.run_id AND calls.seq = firsts.called_seq
LEFT JOIN supervisor_responded AS answers ON firsts.run_id = answers.run_id AND firsts.seq = answers.seq
LEFT JOIN named_grounds AS grounds ON calls.run_id = grounds.run_id AND calls.seq = grounds.seq
LEFT JOIN action_records AS actions ON calls.run_id = actions.run_id AND calls.action_id = actions.action_id
WHERE $run IN ('all', calls.run_id)
