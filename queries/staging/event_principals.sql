-- Title: Every event, its subjects and principals
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per event
-- Key: run_id, seq
-- Units: time_us microseconds of run time; failure counts from 1 within the action
-- NULL: the event's type has no such field, or the record does not name it
-- Example: fsar-ledger query staging/event_principals LEDGER
-- Robot, helper and on_behalf_of are physical facts; the principals are as recorded.
SELECT
    run_id, seq, time_us, caused_by, type, task_id, action_id, request_id, failed_action, failure, robot, helper,
    on_behalf_of, decided_by, requested_by, executed_by, supervised_by, claimant, sender, receiver, path, reason
FROM events
