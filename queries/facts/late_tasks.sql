-- Title: Tasks not completed within their budget, and what held each up
-- Paper: sec:evaluation:metrics (coordination success)
-- Grain: one row per TaskArrived event whose task is completed later than its budget allows, given up, or never ended;
--   except tasks of another system that still had time when its record stopped, or whose ends it does not record
-- Key: run_id, arrived_seq
-- Units: due_us, ended_us microseconds of run time; arrived_seq, ended_seq and held_up_seqs positions in the run, the
--   last of the refusals, unanswered requests, holds and failures of the task's actions
-- NULL: ended_us, ended_seq, is_completed of a task that never ended; due_us of a budget longer than any run, or of a
--   task whose budget is not on record; a completed task of that kind has no row, since no record makes it late
-- Example: fsar-ledger query facts/late_tasks LEDGER
-- A repeated name is another task: its records belong to the last arrival before them.
WITH arrivals AS (
    SELECT
        run_id, task_id, seq, time_us, budget_us,
        row_number() OVER again = 1 AS is_first,
        lead(seq) OVER again AS next_seq
    FROM task_arrived
    WINDOW again AS (PARTITION BY run_id, task_id ORDER BY seq)
),

told AS (
    SELECT
        arrivals.run_id, arrivals.seq,
        min(events.seq) FILTER (events.type IN ('TaskCompleted.v1', 'TaskAbandoned.v1')) AS ended_seq,
        list(events.seq ORDER BY events.seq) FILTER (
            events.type NOT IN ('TaskCompleted.v1', 'TaskAbandoned.v1')
        ) AS held_up_seqs
    FROM arrivals
    INNER JOIN event_principals AS events
        ON
            arrivals.run_id = events.run_id AND arrivals.task_id = events.task_id
            AND (arrivals.is_first OR arrivals.seq < events.seq)
            AND (arrivals.next_seq IS NULL OR arrivals.next_seq > events.seq)
    WHERE
        events.type IN (
            'TaskCompleted.v1', 'TaskAbandoned.v1', 'RequestDenied.v1', 'RequestUnanswered.v1', 'ExecutionHeld.v1',
            'ExecutionFailed.v1'
        )
    GROUP BY arrivals.run_id, arrivals.seq
),

-- A recorder that was opened again had stopped before; time_us is NULL where ends of tasks are not recorded.
stops AS (
    SELECT
        events.run_id, events.seq,
        if(list_has_any(list_cat(begun.observes, begun.records), ['task', 'TaskCompleted']), events.time_us, NULL)
            AS time_us
    FROM event_principals AS events
    INNER JOIN run_started AS begun ON events.run_id = begun.run_id AND begun.kind = 'foreign'
    LEFT JOIN source_opened AS opened ON events.run_id = opened.run_id AND events.seq + 1 = opened.seq
    QUALIFY
        (opened.seq IS NOT NULL AND opened.input_sha256 IS NULL)
        OR lead(events.seq) OVER (PARTITION BY events.run_id ORDER BY events.seq) IS NULL
)

SELECT
    arrived.run_id, arrived.task_id,
    arrived.seq AS arrived_seq,
    try(arrived.time_us + arrived.budget_us) AS due_us,
    told.ended_seq,
    ends.time_us AS ended_us,
    ends.type = 'TaskCompleted.v1' AS is_completed,
    coalesce(told.held_up_seqs, []) AS held_up_seqs
FROM arrivals AS arrived
LEFT JOIN told ON arrived.run_id = told.run_id AND arrived.seq = told.seq
LEFT JOIN event_principals AS ends ON told.run_id = ends.run_id AND told.ended_seq = ends.seq
ASOF LEFT JOIN stops ON arrived.run_id = stops.run_id AND arrived.seq <= stops.seq
WHERE
    ends.type = 'TaskAbandoned.v1' OR ends.time_us - arrived.time_us > arrived.budget_us
    OR (ends.seq IS NULL AND (stops.run_id IS NULL OR arrived.budget_us <= stops.time_us - arrived.time_us))
