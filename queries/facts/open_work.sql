-- Title: Open work at the end of a record that was cut off: tasks within their budget, failures without an end
-- Paper: sec:evaluation:metrics
-- Grain: one row per live or foreign run with any open work
-- Key: run_id
-- Units: open_tasks, open_failures count
-- NULL: never
-- Example: fsar-ledger query facts/open_work LEDGER
-- Stored: facts/censored reads it twice
-- Partial: the rows of a run do not depend on other runs
-- A simulated run ends when nothing is left to happen. The record of a live run ends where it was read, and metrics
-- count open work as not done; that of another system ends when it is stopped, and they count none of it. A recorder
-- that was opened again had stopped before, and has no record of the time between.
WITH ends AS (
    SELECT events.run_id, max(events.time_us) AS end_us
    FROM event_principals AS events
    INNER JOIN runs ON events.run_id = runs.run_id AND runs.kind IN ('foreign', 'live')
    GROUP BY events.run_id
),

stops AS (
    SELECT opened.run_id, opened.seq, last.time_us
    FROM source_opened AS opened
    INNER JOIN event_principals AS last ON opened.run_id = last.run_id AND opened.seq = last.seq + 1
    WHERE opened.input_sha256 IS NULL
),

tasks AS (
    SELECT arrived.run_id, count(*) AS open_count
    FROM task_arrived AS arrived
    INNER JOIN ends ON arrived.run_id = ends.run_id
    ASOF LEFT JOIN stops ON arrived.run_id = stops.run_id AND arrived.seq < stops.seq
    ANTI JOIN task_completed AS done ON arrived.run_id = done.run_id AND arrived.task_id = done.task_id
    ANTI JOIN task_abandoned AS given_up ON arrived.run_id = given_up.run_id AND arrived.task_id = given_up.task_id
    WHERE arrived.budget_us > coalesce(stops.time_us, ends.end_us) - arrived.time_us
    GROUP BY arrived.run_id
),

failures_left AS (
    SELECT failed.run_id, count(*) AS open_count
    FROM execution_failed AS failed
    INNER JOIN ends ON failed.run_id = ends.run_id
    ANTI JOIN failure_resolved AS solved
        ON failed.run_id = solved.run_id AND failed.action_id = solved.action_id AND failed.failure = solved.failure
    ANTI JOIN execution_withdrawn AS withdrawn
        ON failed.run_id = withdrawn.run_id AND failed.action_id = withdrawn.action_id AND failed.seq < withdrawn.seq
    GROUP BY failed.run_id
)

SELECT
    coalesce(tasks.run_id, failures_left.run_id) AS run_id,
    coalesce(tasks.open_count, 0) AS open_tasks,
    coalesce(failures_left.open_count, 0) AS open_failures
FROM tasks
FULL JOIN failures_left ON tasks.run_id = failures_left.run_id
