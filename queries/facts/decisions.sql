-- Title: Decisions, and whether a single principal took each
-- Paper: sec:evaluation:metrics (governance locality)
-- Grain: one row per event of a decision type whose path is not empty; a standing denial that is checked again as time
--   passes is not a new decision
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: decided_by when the record names no decider; task_id, action_id when the record belongs to none
-- Example: fsar-ledger query facts/decisions LEDGER
WITH decided AS MATERIALIZED (
    SELECT
        events.run_id, events.seq, events.time_us, events.type, classes.decision_kind, events.task_id, events.action_id,
        events.decided_by, events.path, events.reason
    FROM event_principals AS events
    INNER JOIN event_classes AS classes ON events.type = classes.type
    WHERE classes.decision_kind IS NOT NULL AND len(events.path) > 0
),

denied_tasks AS (
    SELECT DISTINCT run_id, task_id
    FROM decided
    WHERE decision_kind = 'denial' AND task_id IS NOT NULL
),

compared AS (
    -- Repeated requests and admissions are decisions, too, and as such separate two denials of the task.
    SELECT
        decided.run_id, decided.seq, decided.decision_kind,
        { 'type': type, 'by': decided_by, 'path': path, 'reason': reason } AS content,
        lag(content) OVER (PARTITION BY decided.run_id, decided.task_id ORDER BY decided.seq) AS content_before
    FROM decided
    INNER JOIN denied_tasks ON decided.run_id = denied_tasks.run_id AND decided.task_id = denied_tasks.task_id
),

repeated AS (
    SELECT run_id, seq
    FROM compared
    WHERE decision_kind = 'denial' AND content IS NOT DISTINCT FROM content_before
)

SELECT
    decided.run_id, decided.seq, decided.time_us, decided.type, decided.decision_kind, decided.task_id,
    decided.action_id, decided.decided_by, decided.path,
    coalesce(len(path) = 1 AND (starts_with(decided_by, 'robot/') OR starts_with(decided_by, 'supervisor/')), FALSE)
        AS is_local
FROM decided
LEFT JOIN repeated ON decided.run_id = repeated.run_id AND decided.seq = repeated.seq
WHERE repeated.seq IS NULL
