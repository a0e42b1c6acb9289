-- Title: The events of a run needed to judge later ones, so that a run of years can be judged part by part
-- Paper: sec:evaluation:metrics
-- Grain: one row per event that later events may refer to
-- Key: run_id, seq
-- Units: has_begun whether the arrival of the event's task is on record
-- NULL: has_begun of an event that is about no task and no action
-- Example: fsar-ledger query facts/carried_events LEDGER
-- A task is over when it was completed or given up, no authority for it is held, and no robot works on it. All tasks
-- that began before `since` are over, and left out if they ended before it. Of events of no task, earlier routine
-- operations and types that no judge reads are left out. The last event, which ends the record, brings its task along.
WITH tasks AS (
    SELECT run_id, action_id, min(task_id) AS task_id
    FROM event_principals
    WHERE action_id IS NOT NULL AND task_id IS NOT NULL
    GROUP BY run_id, action_id
),

named AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type,
        coalesce(events.task_id, own.task_id, failed.task_id, events.action_id, events.failed_action) AS task
    FROM event_principals AS events
    LEFT JOIN tasks AS own ON events.run_id = own.run_id AND events.action_id = own.action_id
    LEFT JOIN tasks AS failed ON events.run_id = failed.run_id AND events.failed_action = failed.action_id
),

ends AS (
    SELECT run_id, max(seq) AS last_seq, max(time_us) AS end_us
    FROM named
    GROUP BY run_id
),

under_way AS (
    SELECT DISTINCT begun.run_id, coalesce(tasks.task_id, begun.action_id) AS task
    FROM (
        SELECT run_id, action_id, ended_us
        FROM occupations
        WHERE action_id IS NOT NULL
        UNION ALL
        SELECT run_id, action_id, ended_us FROM claims
    ) AS begun
    INNER JOIN ends ON begun.run_id = ends.run_id AND coalesce(begun.ended_us > ends.end_us, TRUE)
    LEFT JOIN tasks ON begun.run_id = tasks.run_id AND begun.action_id = tasks.action_id
),

spans AS (
    SELECT
        named.run_id, named.task,
        min(named.seq) AS first_seq,
        max(named.seq) AS last_seq,
        bool_or(named.type IN ('TaskArrived.v1', 'OutsiderRequestInjected.v1')) AS has_begun,
        bool_or(named.type IN ('TaskCompleted.v1', 'TaskAbandoned.v1')) AND count(under_way.task) = 0 AS is_over
    FROM named
    LEFT JOIN under_way ON named.run_id = under_way.run_id AND named.task = under_way.task
    WHERE named.task IS NOT NULL
    GROUP BY named.run_id, named.task
),

opened AS (
    SELECT spans.run_id, min(spans.first_seq) AS since
    FROM spans
    INNER JOIN ends ON spans.run_id = ends.run_id
    WHERE NOT (spans.has_begun AND spans.is_over) OR spans.last_seq = ends.last_seq
    GROUP BY spans.run_id
)

SELECT named.run_id, named.seq, spans.has_begun
FROM named
INNER JOIN ends ON named.run_id = ends.run_id
LEFT JOIN opened ON named.run_id = opened.run_id
LEFT JOIN spans ON named.run_id = spans.run_id AND named.task = spans.task
WHERE
    named.seq = ends.last_seq
    OR CASE
        WHEN spans.task IS NOT NULL THEN spans.last_seq >= opened.since
        WHEN starts_with(named.type, 'Routine') THEN named.seq >= opened.since
        ELSE named.type NOT IN (
            'CommandGiven.v1', 'CommandRejected.v1', 'HeartbeatReceived.v1', 'RegistryConsulted.v1', 'RunContinued.v1'
        )
    END
