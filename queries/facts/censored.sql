-- Title: What was open when the record of another system ended, so that its outcome is not known
-- Paper: sec:evaluation:metrics
-- Grain: one row per foreign run and metric that counts outcomes of which some are open
-- Key: run_id, judge
-- Units: open_count tasks that were within their budget, or failures without an end
-- NULL: never
-- Example: fsar-ledger query facts/censored LEDGER
-- A simulated run ends when nothing is left to happen; the record of another system ends when somebody stops it.
WITH ends AS (
    SELECT events.run_id, max(events.time_us) AS end_us
    FROM event_principals AS events
    INNER JOIN runs ON events.run_id = runs.run_id AND runs.kind = 'foreign'
    GROUP BY events.run_id
),

tasks AS (
    SELECT arrived.run_id, count(*) AS open_count
    FROM task_arrived AS arrived
    INNER JOIN ends ON arrived.run_id = ends.run_id
    ANTI JOIN task_completed AS done ON arrived.run_id = done.run_id AND arrived.task_id = done.task_id
    ANTI JOIN task_abandoned AS given_up ON arrived.run_id = given_up.run_id AND arrived.task_id = given_up.task_id
    WHERE arrived.budget_us > ends.end_us - arrived.time_us
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

SELECT run_id, unnest(['coordination_success', 'success_without_violation']) AS judge, open_count
FROM tasks
UNION ALL
SELECT run_id, unnest(['recovery_containment', 'reassignment_latency_s', 'time_to_know_s']) AS judge, open_count
FROM failures_left
