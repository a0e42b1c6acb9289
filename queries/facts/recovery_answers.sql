-- Title: Answers to attempts at recovery, and to requests for help
-- Paper: eq:recovery
-- Grain: one row per record of the result of an attempt or of a request for help
-- Key: run_id, seq
-- Units: question the type of the event that it answers; number counts the attempts at a failure from 1
-- NULL: number for a request for help; helper of an attempt; achieved when nothing was achieved
-- Example: fsar-ledger query facts/recovery_answers LEDGER
SELECT
    run_id, seq, action_id, failure, number, helper,
    if(type = 'RecoveryAttemptFailed.v1', 'RecoveryAttempted.v1', 'AssistanceRequested.v1') AS question,
    CASE type
        WHEN 'AssistanceDeclined.v1' THEN 'declined'
        WHEN 'AssistanceFailed.v1' THEN 'no help: ' || cause
        ELSE result
    END AS answer,
    nullif(array_to_string(achieved, ', '), '') AS achieved
FROM recovery_events
WHERE type IN ('RecoveryAttemptFailed.v1', 'AssistanceDeclined.v1', 'AssistanceFailed.v1')
