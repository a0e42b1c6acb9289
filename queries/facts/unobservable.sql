-- Title: Judgements that a run does not support, because its source does not record what they rest on
-- Paper: sec:evaluation:metrics
-- Grain: one row per run and judge that rests on something the run does not observe
-- Key: run_id, judge
-- Units: none
-- NULL: never; not_observed names the concerns, or the event types and fields of a run that declares which of them it
--   records, or what its record leaves open; hides_offences is whether not even an offence could be found
-- Example: fsar-ledger query facts/unobservable LEDGER
-- Stored: every metric, invariant and grade reads it
-- Partial: the rows of a run do not depend on other runs
WITH sources AS (
    -- There are few kinds of sources and many runs.
    SELECT DISTINCT coalesce(observes, []) AS observes, records
    FROM run_started
),

recorded AS (
    -- Every type of an observed concern is recorded, with all of its fields.
    SELECT sources.observes, sources.records, split_part(concerns.type, '.', 1) AS kind, TRUE AS is_whole
    FROM sources
    INNER JOIN event_concerns AS concerns ON list_contains(sources.observes, concerns.concern)
    UNION
    SELECT observes, records, unnest(records) AS kind, FALSE AS is_whole
    FROM sources
),

needed AS (
    SELECT sources.observes, sources.records, concerns.judge, concerns.concern AS name, concerns.is_context
    FROM sources
    INNER JOIN judged_concerns AS concerns ON NOT list_contains(sources.observes, concerns.concern)
    WHERE sources.records IS NULL OR concerns.judge NOT IN (SELECT judge FROM judged_records)
    UNION ALL
    SELECT sources.observes, sources.records, needs.judge, needs.record AS name, needs.is_context
    FROM sources
    INNER JOIN judged_records AS needs ON sources.records IS NOT NULL
    WHERE
        NOT EXISTS (
            FROM recorded AS own
            WHERE
                own.observes = sources.observes AND own.records = sources.records
                AND (own.kind = needs.record OR (own.is_whole AND starts_with(needs.record, own.kind || '.')))
        )
        AND (
            needs.beside IS NULL
            OR EXISTS (
                FROM recorded AS other
                WHERE
                    other.observes = sources.observes AND other.records = sources.records AND other.kind = needs.beside
            )
        )
),

lacking AS (
    SELECT
        observes, records, judge,
        string_agg(DISTINCT name, ', ' ORDER BY name) AS not_observed,
        bool_or(is_context) AS hides_offences
    FROM needed
    GROUP BY observes, records, judge
)

SELECT
    coalesce(runs.run_id, censored.run_id) AS run_id,
    coalesce(lacking.judge, censored.judge) AS judge,
    coalesce(lacking.not_observed, censored.not_observed) AS not_observed,
    coalesce(lacking.hides_offences, FALSE) OR coalesce(censored.hides_offences, FALSE) AS hides_offences
FROM run_started AS runs
INNER JOIN lacking
    ON coalesce(runs.observes, []) = lacking.observes AND runs.records IS NOT DISTINCT FROM lacking.records
FULL JOIN censored ON runs.run_id = censored.run_id AND lacking.judge = censored.judge
