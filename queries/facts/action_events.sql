-- Title: Events and the actions they are about, including actions named only by a cause or an effect
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per event and action that it is about
-- Key: run_id, seq, action_id
-- Units: none
-- NULL: never
-- Example: fsar-ledger query facts/action_events LEDGER
SELECT run_id, seq, action_id FROM keyed_events
WHERE action_id IS NOT NULL
UNION
SELECT run_id, seq, action_id FROM competing_calls
UNION
SELECT run_id, seq, action_id FROM denied_actions
WHERE action_id IS NOT NULL
UNION
-- An own step that names no action is about the action of its effect.
SELECT decided.run_id, decided.seq, caused.action_id
FROM own_step_decided AS decided
INNER JOIN keyed_events AS caused ON decided.run_id = caused.run_id AND decided.seq = caused.caused_by
WHERE decided.action_id IS NULL AND caused.action_id IS NOT NULL
