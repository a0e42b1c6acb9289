-- Title: Events by day and type, in runs with a known start, to compare days or recordings
-- Paper: sec:evaluation:metrics
-- Grain: one row per run, UTC day with records of the run, and event type that the run records, or that occurred on
--   that day
-- Key: run_id, day, type
-- Units: event_count events; recorded_s seconds from the first to the last event of the run on that day
-- NULL: never; a type that the run does not record has no row, since its number of events is unknown
-- Example: fsar-ledger query audit/events_by_day LEDGER answers ExecutionFailed: 2 on 2026-03-01 and 0 on 2026-03-02
WITH dated AS (
    SELECT
        events.run_id, split_part(events.type, '.', 1) AS type, events.time_us,
        (begun.epoch + to_microseconds(events.time_us))::DATE AS day
    FROM events
    INNER JOIN run_epochs AS begun ON events.run_id = begun.run_id
),

days AS (
    SELECT run_id, day, (max(time_us) - min(time_us)) / 1000000 AS recorded_s
    FROM dated
    GROUP BY run_id, day
),

counts AS (
    SELECT run_id, day, type, count(*) AS event_count
    FROM dated
    GROUP BY run_id, day, type
),

recorded AS (
    SELECT DISTINCT runs.run_id, split_part(concerns.type, '.', 1) AS type
    FROM run_started AS runs
    INNER JOIN event_concerns AS concerns
        ON
            list_contains(runs.observes, concerns.concern)
            OR list_contains(runs.records, split_part(concerns.type, '.', 1))
),

expected AS (
    SELECT days.run_id, days.day, recorded.type
    FROM days INNER JOIN recorded ON days.run_id = recorded.run_id
    UNION
    SELECT run_id, day, type FROM counts
)

SELECT
    expected.run_id, expected.day, expected.type,
    coalesce(counts.event_count, 0) AS event_count,
    days.recorded_s
FROM expected
INNER JOIN days ON expected.run_id = days.run_id AND expected.day = days.day
LEFT JOIN counts
    ON expected.run_id = counts.run_id AND expected.day = counts.day AND expected.type = counts.type
