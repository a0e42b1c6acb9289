-- Title: The call behind each answer of a supervisor
-- Paper: eq:supervision
-- Grain: one row per SupervisorResponded event with an earlier call for the same action and purpose
-- Key: run_id, seq
-- Units: seq, called_seq positions in the run of the answer and of the call; called_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query facts/answered_calls LEDGER
-- No record names the call: it is the last call to the supervisor that answers, else the last call to any.
WITH matched AS (
    SELECT
        answers.run_id, answers.seq,
        coalesce(
            max(calls.seq) FILTER (calls.supervisor = answers.decided_by), max(calls.seq)
        ) AS called_seq
    FROM supervisor_responded AS answers
    INNER JOIN supervisor_called AS calls
        ON
            answers.run_id = calls.run_id AND answers.action_id IS NOT DISTINCT FROM calls.action_id
            AND answers.purpose = calls.purpose AND answers.seq > calls.seq
    GROUP BY answers.run_id, answers.seq
)

SELECT matched.run_id, matched.seq, matched.called_seq, calls.time_us AS called_us
FROM matched
INNER JOIN supervisor_called AS calls ON matched.run_id = calls.run_id AND matched.called_seq = calls.seq
