-- Title: The policies that requests carry, until the action is requested anew
-- Paper: eq:policy, eq:request
-- Grain: one row per RequestIssued and RequestRelayed event
-- Key: run_id, seq
-- Units: seq, replaced_seq positions in the run
-- NULL: action_id where the record names none; outcome of a request that carries none; replaced_seq of the last request
--   for the action, and of its relays
-- Example: fsar-ledger query facts/policies_carried LEDGER
SELECT
    run_id, seq, action_id,
    carried_policy AS outcome,
    min(CASE type WHEN 'RequestIssued.v1' THEN seq END) OVER (
        PARTITION BY run_id, action_id ORDER BY seq ROWS BETWEEN 1 FOLLOWING AND UNBOUNDED FOLLOWING
    ) AS replaced_seq
FROM request_events
WHERE type IN ('RequestIssued.v1', 'RequestRelayed.v1')
