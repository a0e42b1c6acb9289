-- Title: What one supervisor decided, when it had been called, and how long that took
-- Paper: eq:supervision
-- Grain: one row per SupervisorResponded event
-- Units: called_us, decided_us microseconds of run time; waited_us microseconds
-- NULL: called_us, waited_us when no call for this purpose came before; decided_by when the record names no decider
-- Example: fsar-ledger query audit/supervisor_decisions LEDGER --param supervisor=supervisor/fleet
--   answers recovery of A1-1/4.1, called at 84.854 s, decided at 124.92 s
-- Parameters: run = all, supervisor = all
SELECT
    responses.run_id,
    responses.seq,
    responses.decided_by,
    responses.purpose,
    responses.action_id,
    responses.requested_by,
    responses.executed_by,
    max(calls.time_us) AS called_us,
    responses.time_us AS decided_us,
    responses.time_us - max(calls.time_us) AS waited_us
FROM supervisor_responded AS responses
LEFT JOIN supervisor_called AS calls
    ON
        responses.run_id = calls.run_id
        AND responses.action_id = calls.action_id
        AND responses.purpose = calls.purpose
        AND responses.seq > calls.seq
WHERE $run IN ('all', responses.run_id) AND $supervisor IN ('all', responses.decided_by)
GROUP BY
    responses.run_id, responses.seq, responses.decided_by, responses.purpose, responses.action_id, responses.requested_by, responses.executed_by,
    responses.time_us
