-- Title: Answers to requests by executors, or a relay on the way, with the request
-- Paper: eq:admissible, eq:auth
-- Grain: one row per RequestAdmitted, RequestDenied or RequestCountered event of an action that was requested before
-- Key: run_id, seq
-- Units: time_us microseconds of run time; seq, asked_seq positions in the run
-- NULL: conjunct unless denied; trust and the authority tuple where the record gives none; parent, relay when the
--   request has none
-- Example: fsar-ledger query facts/evaluations LEDGER
WITH judged AS (
    SELECT
        answers.run_id, answers.seq,
        max(asked.seq) AS asked_seq
    FROM request_events AS answers
    INNER JOIN request_issued AS asked
        ON answers.run_id = asked.run_id AND answers.action_id = asked.action_id AND answers.seq > asked.seq
    WHERE answers.type IN ('RequestAdmitted.v1', 'RequestDenied.v1', 'RequestCountered.v1')
    GROUP BY answers.run_id, answers.seq
)

SELECT
    answers.run_id, answers.seq, judged.asked_seq, answers.time_us, answers.action_id,
    asked.task_id AS context,
    asked.requested_by,
    coalesce(answers.executed_by, asked.executed_by) AS executed_by,
    asked.relay, asked.parent, asked.capability,
    asked.override AS override_asked,
    answers.decided_by, answers.type,
    CASE answers.type
        WHEN 'RequestAdmitted.v1' THEN 'admitted' WHEN 'RequestDenied.v1' THEN 'denied' ELSE 'countered'
    END AS verdict,
    answers.reason AS conjunct,
    answers.trust, answers.may_request, answers.may_execute, answers.override, answers.is_audited
FROM judged
INNER JOIN request_events AS answers ON judged.run_id = answers.run_id AND judged.seq = answers.seq
INNER JOIN request_issued AS asked ON judged.run_id = asked.run_id AND judged.asked_seq = asked.seq
