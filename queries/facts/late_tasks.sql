-- Title: Tasks that are not completed within their budget, and what held each up
-- Paper: sec:evaluation:metrics (coordination success)
-- Grain: one row per TaskArrived event whose task is completed later than its budget allows, given up, or never ended
-- Key: run_id, arrived_seq
-- Units: due_us, ended_us microseconds of run time; arrived_seq, ended_seq and held_up_seqs positions in the run, the
--   last of the refusals, unanswered requests, holds and failures of the task's actions
-- NULL: ended_us, ended_seq, is_completed of a task that never ended; due_us of a budget longer than any run
-- Example: fsar-ledger query facts/late_tasks LEDGER
WITH ends AS (
    SELECT run_id, task_id, seq, time_us, TRUE AS is_completed FROM task_completed
    UNION ALL
    SELECT run_id, task_id, seq, time_us, FALSE AS is_completed FROM task_abandoned
),

first_ends AS (
    SELECT
        run_id, task_id,
        min(seq) AS ended_seq,
        arg_min(time_us, seq) AS ended_us,
        arg_min(is_completed, seq) AS is_completed
    FROM ends
    GROUP BY run_id, task_id
),

obstacles AS (
    SELECT run_id, task_id, seq FROM request_denied
    UNION ALL
    SELECT run_id, task_id, seq FROM request_unanswered
    UNION ALL
    SELECT run_id, task_id, seq FROM execution_held
    UNION ALL
    SELECT run_id, task_id, seq FROM execution_failed
),

held_up AS (
    SELECT
        run_id, task_id,
        list(seq ORDER BY seq) AS held_up_seqs
    FROM obstacles
    WHERE task_id IS NOT NULL
    GROUP BY run_id, task_id
)

SELECT
    arrived.run_id, arrived.task_id,
    arrived.seq AS arrived_seq,
    try(arrived.time_us + arrived.budget_us) AS due_us,
    first_ends.ended_seq, first_ends.ended_us, first_ends.is_completed,
    coalesce(held_up.held_up_seqs, []) AS held_up_seqs
FROM task_arrived AS arrived
LEFT JOIN first_ends ON arrived.run_id = first_ends.run_id AND arrived.task_id = first_ends.task_id
LEFT JOIN held_up ON arrived.run_id = held_up.run_id AND arrived.task_id = held_up.task_id
WHERE NOT coalesce(first_ends.is_completed AND first_ends.ended_us - arrived.time_us <= arrived.budget_us, FALSE)
