-- Title: The owner of the decision that led to an event: the nearest decision among its causes
-- Paper: sec:evaluation:metrics (governance locality)
-- Grain: one row per run that has an event with this number
-- Key: run_id
-- Units: steps causes between the event and the decision (0: the event is the decision); decided_us microseconds of run
--   time
-- NULL: the decision's columns when neither the event nor a cause is a decision; decided_by when the record names no
--   decider; is_local when the record of another system names no path either
-- Example: fsar-ledger query audit/decision_owner LEDGER --param run=RUN --param seq=107
--   answers for an ExecutionFinished: RequestAccepted, 3 causes back, by robot/C1 alone, so it was local
-- Parameters: seq: seq, run: run = all
WITH RECURSIVE causes AS (
    SELECT run_id, seq, caused_by
    FROM event_principals
    WHERE $run IN ('all', run_id) AND seq <= $seq::BIGINT
),

way_back AS (
    SELECT causes.run_id, causes.seq, causes.caused_by, 0 AS steps
    FROM causes
    WHERE causes.seq = $seq::BIGINT
    UNION ALL
    SELECT
        causes.run_id, causes.seq, causes.caused_by,
        way_back.steps + 1 AS steps
    FROM way_back
    -- A cause precedes its effect; a forged record that claims otherwise ends the search.
    INNER JOIN causes
        ON way_back.run_id = causes.run_id AND way_back.caused_by = causes.seq AND way_back.seq > causes.seq
),

made AS (
    SELECT run_id, seq, decision_kind, is_local FROM decisions
    UNION ALL
    -- In our own runs an event without a path is no decision; another system may leave out the decider.
    SELECT
        events.run_id, events.seq, classes.decision_kind,
        NULL AS is_local
    FROM event_principals AS events
    INNER JOIN event_classes AS classes ON events.type = classes.type AND classes.decision_kind IS NOT NULL
    INNER JOIN runs ON events.run_id = runs.run_id AND runs.kind = 'foreign'
    WHERE len(events.path) = 0
),

nearest AS (
    SELECT
        way_back.run_id,
        min(way_back.steps) AS steps,
        arg_min(made.seq, way_back.steps) AS decision_seq
    FROM way_back
    INNER JOIN made ON way_back.run_id = made.run_id AND way_back.seq = made.seq
    GROUP BY way_back.run_id
)

SELECT
    asked.run_id, asked.seq, asked.type, nearest.steps, nearest.decision_seq,
    decision.type AS decision_type,
    made.decision_kind,
    decision.time_us AS decided_us,
    decision.decided_by, decision.path, made.is_local
FROM event_principals AS asked
LEFT JOIN nearest ON asked.run_id = nearest.run_id
LEFT JOIN made ON nearest.run_id = made.run_id AND nearest.decision_seq = made.seq
LEFT JOIN event_principals AS decision ON made.run_id = decision.run_id AND made.seq = decision.seq
WHERE $run IN ('all', asked.run_id) AND asked.seq = $seq::BIGINT
