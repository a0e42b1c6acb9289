-- Title: Events that contradict what their run says it observes
-- Paper: sec:evaluation:metrics
-- Grain: one row per event of a concern that its run neither observes nor records types of, and per unknown concern
--   that a run declares
-- Key: run_id, seq?, concern
-- Units: none
-- NULL: seq, type of an unknown concern
-- Example: fsar-ledger query audit/undeclared_events LEDGER
--   answers nothing for a ledger that verifies; else run, seq and concern of each event that its run says it does not
--   observe
-- The run tells its reader that these things were not observed, yet has events of them: either the declaration or the
-- events are wrong. Recording a type counts as declaring its concern, as in `verify`.
WITH recorded AS (
    SELECT
        run_id,
        split_part(unnest(records), '.', 1) AS type
    FROM run_started
),

named AS (
    SELECT
        run_id,
        unnest(observes) AS concern
    FROM runs
    UNION
    SELECT recorded.run_id, kinds.concern
    FROM recorded
    INNER JOIN event_concerns AS kinds ON recorded.type = split_part(kinds.type, '.', 1)
)

SELECT events.run_id, events.seq, events.type, event_concerns.concern
FROM event_principals AS events
INNER JOIN event_concerns ON events.type = event_concerns.type
INNER JOIN runs ON events.run_id = runs.run_id
ANTI JOIN named ON events.run_id = named.run_id AND event_concerns.concern = named.concern
UNION ALL
SELECT named.run_id, NULL AS seq, NULL AS type, named.concern
FROM named
LEFT JOIN event_concerns ON named.concern = event_concerns.concern
WHERE event_concerns.concern IS NULL
