-- Title: The timeline of an action: who asked, who allowed, who acted, who supervised
-- Paper: fig:wf1, sec:model:request, sec:architecture:fleet
-- Grain: one row per message or deed of the action
-- Key: run_id, action_id, seq, message
-- Units: step counts from 1 within the action; time_s seconds of run time; clock the time in UTC
-- NULL: clock where the start of the run is unknown; sender, receiver when the record does not name them; note when
--   there is nothing to add. Records that name no action belong to the timeline when they caused, or were caused by,
--   one that does; is_tied marks them
-- Example: fsar-ledger query audit/request_timeline LEDGER --param run=RUN --param action=A1-1/4.1
--   answers robot/A1 lacks door.open.secure, asks service/registry, requests it of robot/B1, which evaluates, accepts,
--   executes: success
-- Parameters: run: run = all, action: action = all
WITH RECURSIVE known AS (
    SELECT
        keyed_events.run_id, keyed_events.seq, keyed_events.caused_by, keyed_events.action_id,
        keyed_events.type IN (SELECT message_words.type FROM message_words) AS is_told
    FROM keyed_events
    WHERE $run IN ('all', keyed_events.run_id)
),

own AS (
    SELECT run_id, action_id, seq, caused_by
    FROM known
    WHERE action_id IS NOT NULL AND $action IN ('all', action_id)
    UNION
    SELECT run_id, action_id, seq, NULL AS caused_by
    FROM competing_calls
    WHERE $run IN ('all', run_id) AND $action IN ('all', action_id)
),

steps AS (
    SELECT
        run_id,
        unnest([seq, caused_by]) AS from_seq,
        unnest([caused_by, seq]) AS to_seq
    FROM known
),

chain AS (
    SELECT own.run_id, own.action_id, own.seq, own.caused_by, TRUE AS is_tied
    FROM own
    UNION
    -- Its causes and effects, as far as their records name no action.
    SELECT known.run_id, chain.action_id, known.seq, known.caused_by, FALSE AS is_tied
    FROM chain
    INNER JOIN steps ON chain.run_id = steps.run_id AND chain.seq = steps.from_seq
    INNER JOIN known ON steps.run_id = known.run_id AND steps.to_seq = known.seq
    WHERE known.action_id IS NULL AND known.is_told AND (chain.caused_by = known.seq OR chain.seq = known.caused_by)
)

SELECT
    chain.run_id, chain.action_id,
    row_number() OVER (PARTITION BY chain.run_id, chain.action_id ORDER BY messages.seq, messages.part) AS step,
    messages.seq,
    messages.time_us / 1000000 AS time_s,
    strftime(begun.epoch + to_microseconds(messages.time_us), '%Y-%m-%dT%H:%M:%S.%gZ') AS clock,
    messages.sender, messages.receiver,
    CASE
        WHEN messages.type = 'RequestAdmitted.v1' THEN 'evaluation'
        WHEN coalesce(messages.sender, '') = coalesce(messages.receiver, '') THEN 'deed'
        ELSE 'message'
    END AS kind,
    messages.message, messages.note, chain.is_tied
FROM chain
INNER JOIN messages ON chain.run_id = messages.run_id AND chain.seq = messages.seq
LEFT JOIN run_epochs AS begun ON chain.run_id = begun.run_id
