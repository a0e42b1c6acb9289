-- Title: Decisions, and whether a single principal took each
-- Paper: sec:evaluation:metrics (governance locality)
-- Grain: one row per event of a decision type whose path is not empty; a standing denial that is looked at again as
--   time passes is not decided again
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: decided_by when the record names no decider; task_id, action_id when the record is not tied to one
-- Example: fsar-ledger query facts/decisions LEDGER
WITH decided AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type, classes.decision_kind, events.task_id, events.action_id,
        events.decided_by, events.path,
        { 'type': events.type, 'by': events.decided_by, 'path': events.path, 'reason': events.reason } AS content
    FROM event_principals AS events
    INNER JOIN event_classes AS classes ON events.type = classes.type
    WHERE classes.decision_kind IS NOT NULL AND len(events.path) > 0
),

followed AS (
    -- To ask again and to admit are decisions, too: then another decision of the task lies between two denials.
    SELECT
        run_id, seq, time_us, type, decision_kind, task_id, action_id, decided_by, path, content,
        lag(content) OVER (PARTITION BY run_id, task_id ORDER BY seq) AS content_before
    FROM decided
)

SELECT
    run_id, seq, time_us, type, decision_kind, task_id, action_id, decided_by, path,
    coalesce(len(path) = 1 AND (starts_with(decided_by, 'robot/') OR starts_with(decided_by, 'supervisor/')), FALSE)
        AS is_local
FROM followed
WHERE decision_kind <> 'denial' OR task_id IS NULL OR content IS DISTINCT FROM content_before
