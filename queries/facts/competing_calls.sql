-- Title: Calls to a supervisor to order two actions, and the answers, by competing action
-- Paper: sec:prototype:workflows (Workflow 3), eq:supervision
-- Grain: one row per SupervisorCalled event that names another action as competing, and per answer to it
-- Key: run_id, seq, action_id
-- Units: none
-- NULL: never; action_id is the competing action; the event itself names the action for which the supervisor was called
-- Example: fsar-ledger query facts/competing_calls LEDGER
WITH calls AS (
    SELECT run_id, seq, action_id AS called_for, competing AS action_id
    FROM supervisor_called
    WHERE competing IS NOT NULL AND competing IS DISTINCT FROM action_id
)

SELECT run_id, seq, action_id
FROM calls
UNION
SELECT calls.run_id, answers.seq, calls.action_id
FROM calls
INNER JOIN supervisor_responded AS answers
    ON
        calls.run_id = answers.run_id AND calls.called_for = answers.action_id AND calls.seq < answers.seq
        AND answers.purpose = 'ordering'
