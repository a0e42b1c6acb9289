-- Title: Executions without an approval although a review was in force
-- Paper: eq:policy, sec:evaluation:metrics (policy violations)
-- Grain: one row per execution or motion that began under review and had no earlier approval of its action
-- Key: run_id, seq
-- Units: started_us, called_us microseconds of run time
-- NULL: action_id and on_behalf_of for a motion; called_us when no earlier call to review it is on record
-- Example: fsar-ledger query audit/unapproved_executions LEDGER --param run=RUN
--   answers A1-1/4.1 by robot/B1 for robot/A1 at 31.013 s, and nobody had been asked
-- Parameters: run: run = all
SELECT
    starts.run_id, starts.seq, starts.started_us, starts.action_id, starts.robot, starts.on_behalf_of,
    min(calls.time_us) AS called_us
FROM governed_starts AS starts
LEFT JOIN supervisor_called AS calls
    ON
        starts.run_id = calls.run_id AND starts.action_id = calls.action_id AND starts.seq > calls.seq
        AND calls.purpose = 'review'
WHERE starts.outcome = 'review' AND NOT starts.is_approved AND $run IN ('all', starts.run_id)
GROUP BY ALL
