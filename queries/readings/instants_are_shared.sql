-- Title: A claim still holds at the instant at which it ends
-- Paper: sec:evaluation:metrics
-- Reading: R6
-- Question: whether touching claims overlap
-- Replaces: claims
-- Moves: authority_conflicts
-- Why: Simultaneous may include the instant at which one principal gives up what another takes.
-- Grain: one row per AuthorityClaimed event
-- Key: run_id, seq
-- Units: as in claims
-- NULL: as in claims
-- Example: fsar-ledger query readings/instants_are_shared LEDGER
SELECT * REPLACE (ended_us + 1 AS ended_us)
FROM claims
