-- Title: Events that contradict what their run says it observes
-- Paper: sec:evaluation:metrics
-- Grain: one row per event of a concern that its run does not observe, and per concern that a run observes and nobody
--   knows
-- Key: run_id, seq?, concern
-- Units: none
-- NULL: seq, type of a concern that nobody knows
-- Example: fsar-ledger query audit/undeclared_events LEDGER
--   answers nothing for a ledger that verifies; else run, seq and concern of each event that its run says it does not
--   observe
-- A reader of such a run is told that these things were not observed, and then meets some: either the declaration is
-- wrong or the events are.
WITH named AS (
    SELECT
        run_id,
        unnest(observes) AS concern
    FROM runs
)

SELECT events.run_id, events.seq, events.type, event_concerns.concern
FROM event_principals AS events
INNER JOIN event_concerns ON events.type = event_concerns.type
INNER JOIN runs ON events.run_id = runs.run_id
WHERE NOT list_contains(coalesce(runs.observes, []), event_concerns.concern)
UNION ALL
SELECT named.run_id, NULL AS seq, NULL AS type, named.concern
FROM named
LEFT JOIN event_concerns ON named.concern = event_concerns.concern
WHERE event_concerns.concern IS NULL
