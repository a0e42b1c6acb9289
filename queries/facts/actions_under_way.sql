-- Title: Actions of other systems that were under way when their record began
-- Paper: sec:architecture:invariants (A5)
-- Grain: one row per action of a foreign run without a recorded beginning and without a recorded arrival of its task
-- Key: run_id, action_id
-- Units: failed_seq position in the run of its first failure on record; own_starts, starts_for_others executions that
--   a robot started for itself, and for another one
-- NULL: failed_seq without a failure
-- Example: fsar-ledger query facts/actions_under_way LEDGER
-- Stored: three invariants and the count of their cases read it
-- Partial: the rows of a run do not depend on other runs
-- Their requests and permissions came before the record, so the absence of these is no offence. Where a source records
-- no arrivals, such actions cannot be told from actions that nobody requested.
WITH recording AS (
    SELECT runs.run_id
    FROM run_started AS runs
    INNER JOIN event_concerns AS concerns ON concerns.type = 'TaskArrived.v1'
    WHERE
        runs.kind = 'foreign'
        AND (list_contains(runs.records, 'TaskArrived') OR list_contains(runs.observes, concerns.concern))
),

actions AS (
    SELECT
        events.run_id,
        coalesce(events.failed_action, events.action_id) AS action_id,
        max(events.task_id) AS task_id,
        min(events.seq) FILTER (WHERE events.type = 'ExecutionFailed.v1') AS failed_seq,
        count(*) FILTER (events.type = 'ExecutionStarted.v1' AND events.robot = events.on_behalf_of) AS own_starts,
        count(*) FILTER (events.type = 'ExecutionStarted.v1' AND events.robot <> events.on_behalf_of)
            AS starts_for_others,
        bool_or(events.type IN ('StepBegan.v1', 'GapDetected.v1', 'RequestIssued.v1', 'OwnStepDecided.v1')) AS is_begun
    FROM event_principals AS events
    INNER JOIN recording ON events.run_id = recording.run_id
    WHERE coalesce(events.failed_action, events.action_id) IS NOT NULL
    GROUP BY ALL
)

SELECT actions.run_id, actions.action_id, actions.failed_seq, actions.own_starts, actions.starts_for_others
FROM actions
ANTI JOIN task_arrived AS arrived ON actions.run_id = arrived.run_id AND actions.task_id = arrived.task_id
WHERE NOT actions.is_begun
