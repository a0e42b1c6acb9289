-- Title: Only failures that leave their first level have a latency
-- Paper: sec:evaluation:metrics
-- Reading: R5
-- Question: what ends the latency
-- Replaces: failures
-- Moves: reassignment_latency_s
-- Why: The definition ends at a reassignment or an escalation; a failure that the robot itself resolves has neither.
-- Grain: one row per failure
-- Key: run_id, seq
-- Units: as in failures
-- NULL: as in failures
-- Example: fsar-ledger query readings/latency_of_departures LEDGER
SELECT * REPLACE (left_us - detected_us AS latency_us)
FROM failures
