-- Title: What came of each attempt at recovery, and of each question for help
-- Paper: eq:recovery
-- Grain: one row per failure and attempt, or helper that was asked, of which the record says what came of it
-- Key: run_id, action_id, failure, number?, helper?
-- Units: number counts the attempts at a failure from 1
-- NULL: number of a question for help; helper of an attempt; achieved when not even a part was
-- Example: fsar-ledger query facts/recovery_answers LEDGER
SELECT
    run_id, action_id, failure, number, helper,
    arg_min(
        if(type = 'AssistanceDeclined.v1', 'busy', if(type = 'AssistanceFailed.v1', 'no help: ' || cause, result)), seq
    ) AS answer,
    arg_min(nullif(array_to_string(achieved, ', '), ''), seq) AS achieved
FROM recovery_events
WHERE type IN ('RecoveryAttemptFailed.v1', 'AssistanceDeclined.v1', 'AssistanceFailed.v1')
GROUP BY run_id, action_id, failure, number, helper
