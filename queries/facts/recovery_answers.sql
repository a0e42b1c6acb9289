-- Title: What came of an attempt to recover, or of a question for help, where the record says so
-- Paper: eq:recovery
-- Grain: one row per failure and attempt that failed, and per failure and helper that declined or could not help
-- Units: number counts from 1 within the failure
-- NULL: number for a helper; helper for an attempt; achieved when nothing was
-- Example: fsar-ledger query facts/recovery_answers LEDGER
SELECT
    run_id,
    action_id,
    failure,
    number,
    helper,
    any_value(CASE type WHEN 'AssistanceDeclined.v1' THEN 'busy' WHEN 'AssistanceFailed.v1' THEN 'no help: ' || cause ELSE result END) AS answer,
    any_value(nullif(array_to_string(achieved, ', '), '')) AS achieved
FROM events
WHERE type IN ('RecoveryAttemptFailed.v1', 'AssistanceDeclined.v1', 'AssistanceFailed.v1')
GROUP BY run_id, action_id, failure, number, helper
