-- Title: Tasks that are not completed within their budget, and what held each up
-- Paper: sec:evaluation:metrics (coordination success)
-- Grain: one row per TaskArrived event whose task is completed later than its budget allows, given up, or never ended
-- Key: run_id, arrived_seq
-- Units: due_us, ended_us microseconds of run time; arrived_seq, ended_seq and held_up_seqs positions in the run, the
--   last of the refusals, unanswered requests, holds and failures of the task's actions
-- NULL: ended_us, ended_seq, is_completed of a task that never ended; due_us of a budget longer than any run, or of a
--   task whose budget is not on record; completed, such a task is not here, since nothing says that it was late
-- Example: fsar-ledger query facts/late_tasks LEDGER
WITH ends AS (
    SELECT run_id, task_id, seq, time_us, TRUE AS is_completed FROM task_completed
    UNION ALL
    SELECT run_id, task_id, seq, time_us, FALSE AS is_completed FROM task_abandoned
),

-- A name that comes again is another task: an end is that of the arrival before it.
arrivals AS (
    SELECT
        run_id, task_id, seq, time_us, budget_us,
        row_number() OVER again = 1 AS is_first,
        lead(seq) OVER again AS next_seq
    FROM task_arrived
    WINDOW again AS (PARTITION BY run_id, task_id ORDER BY seq)
),

first_ends AS (
    SELECT
        arrivals.run_id,
        arrivals.seq AS arrived_seq,
        min(ends.seq) AS ended_seq,
        arg_min(ends.time_us, ends.seq) AS ended_us,
        arg_min(ends.is_completed, ends.seq) AS is_completed
    FROM arrivals
    INNER JOIN ends
        ON
            arrivals.run_id = ends.run_id AND arrivals.task_id = ends.task_id
            AND (arrivals.is_first OR arrivals.seq < ends.seq)
            AND (arrivals.next_seq IS NULL OR arrivals.next_seq > ends.seq)
    GROUP BY arrivals.run_id, arrivals.seq
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
FROM arrivals AS arrived
LEFT JOIN first_ends ON arrived.run_id = first_ends.run_id AND arrived.seq = first_ends.arrived_seq
LEFT JOIN held_up ON arrived.run_id = held_up.run_id AND arrived.task_id = held_up.task_id
WHERE first_ends.is_completed IS NOT TRUE OR first_ends.ended_us - arrived.time_us > arrived.budget_us
