-- Title: The levels that each failure's recovery reached, in order
-- Paper: eq:recovery
-- Grain: one row per move of a failure's recovery to a level; attempts that stay at the level add no row
-- Key: run_id, action_id, failure, seq
-- Units: time_us microseconds of run time; move number of the row within the failure from 1; *_rank 1 local to 4 human
-- NULL: decided_by when the record names no decider; from_level, from_rank for the first level of a failure, unless it
--   is an escalation that names the level before; reason, why the previous level was left, for the first level and
--   where the record does not give it
-- Example: fsar-ledger query audit/recovery_moves LEDGER
--   answers A1-1/4.1: local at 80.172 s, peer at 84.274 s, fleet at 84.339 s, human at 84.854 s
WITH ranks (level, rank) AS (
    VALUES
    ('local', 1),
    ('peer', 2),
    ('fleet', 3),
    ('human', 4)
),

records AS (
    SELECT
        events.run_id,
        coalesce(events.failed_action, events.action_id) AS action_id,
        events.failure, events.seq, events.time_us, events.type, events.decided_by, events.reason, ranks.level,
        ranks.rank,
        before.level AS left_level,
        before.rank AS left_rank
    FROM recovery_events AS events
    INNER JOIN ranks ON coalesce(events.to_level, events.level) = ranks.level
    LEFT JOIN ranks AS before ON events.level = before.level AND events.to_level IS NOT NULL
    WHERE
        events.type IN ('RecoveryAttempted.v1', 'AssistanceRequested.v1', 'RecoveryEscalated.v1', 'FailureResolved.v1')
),

steps AS (
    SELECT
        run_id, action_id, failure, seq, time_us, type, decided_by, reason, level, rank,
        coalesce(lag(level) OVER failures, left_level) AS from_level,
        coalesce(lag(rank) OVER failures, left_rank) AS from_rank
    FROM records
    WINDOW failures AS (PARTITION BY run_id, action_id, failure ORDER BY seq)
)

SELECT
    run_id, action_id, failure,
    row_number() OVER (PARTITION BY run_id, action_id, failure ORDER BY seq) AS move,
    seq, time_us, type, decided_by, from_level, from_rank, level, rank, reason
FROM steps
WHERE from_level IS NULL OR from_level <> level
