-- Title: Refusals by reason: requests denied or unanswered, help declined, executions held
-- Paper: sec:model:request
-- Grain: one row per run, type of refusal, reason and principal that decided it
-- Units: refusals count; first_us, last_us microseconds of run time
-- NULL: decided_by when the record names no decider; the reason of an unanswered request and of declined help is what their type means
-- Example: fsar-ledger query audit/refusals LEDGER --param run=RUN
--   answers RequestDenied, not visible, by service/registry: 2, the first at 9.797 s
-- Parameters: run = all, reason = all
WITH refused AS (
    SELECT
        run_id,
        time_us,
        type,
        CASE type WHEN 'RequestUnanswered.v1' THEN 'no candidate' WHEN 'AssistanceDeclined.v1' THEN 'helper busy' ELSE reason END AS reason,
        CASE type WHEN 'AssistanceDeclined.v1' THEN helper ELSE decided_by END AS decided_by
    FROM events
    WHERE type IN ('RequestDenied.v1', 'RequestUnanswered.v1', 'AssistanceDeclined.v1', 'ExecutionHeld.v1')
)

SELECT
    run_id,
    type,
    reason,
    decided_by,
    count(*) AS refusals,
    min(time_us) AS first_us,
    max(time_us) AS last_us
FROM refused
WHERE $run IN ('all', run_id) AND $reason IN ('all', reason)
GROUP BY run_id, type, reason, decided_by
