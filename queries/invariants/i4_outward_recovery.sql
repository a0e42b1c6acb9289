-- Title: I4 broken: recovery of a failure skips a level, goes back, overruns its time, or is resolved by a level that it is not at
-- Paper: sec:model:invariants (I4), eq:recovery
-- Grain: one row per recovery event whose level is not the one reached, whose step is not to the next level outward, or that begins too late
-- Units: time_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query invariants/i4_outward_recovery LEDGER
WITH ranks (level, rank) AS (
    VALUES
    ('local', 1),
    ('peer', 2),
    ('fleet', 3),
    ('human', 4)
),

moves AS (
    SELECT
        events.run_id,
        events.seq,
        events.time_us,
        events.type,
        coalesce(events.failed_action, events.action_id) AS action_id,
        events.failure,
        coalesce(events.level, CASE events.type WHEN 'ReassignmentDecided.v1' THEN 'fleet' END) AS level,
        events.deadline_us,
        events.to_level,
        ranks.rank,
        targets.rank AS to_rank
    FROM events
    LEFT JOIN ranks ON coalesce(events.level, CASE events.type WHEN 'ReassignmentDecided.v1' THEN 'fleet' END) = ranks.level
    LEFT JOIN ranks AS targets ON events.to_level = targets.level
    WHERE
        events.type IN (
            'ExecutionFailed.v1', 'RecoveryAttempted.v1', 'AssistanceRequested.v1', 'AssistanceAdmitted.v1', 'ReassignmentDecided.v1', 'RecoveryEscalated.v1',
            'FailureResolved.v1'
        )
),

placed AS (
    -- Every failure begins at the local level; an escalation sets the level from then on, also one that should not have been.
    SELECT
        *,
        coalesce(last_value(to_rank IGNORE NULLS) OVER earlier, 1) AS reached,
        coalesce(bool_or(type = 'ExecutionFailed.v1') OVER earlier, FALSE) AS has_failed,
        coalesce(bool_or(type = 'FailureResolved.v1') OVER earlier, FALSE) AS is_resolved
    FROM moves
    WINDOW earlier AS (PARTITION BY run_id, action_id, failure ORDER BY seq ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING)
),

judged AS (
    SELECT
        *,
        CASE
            WHEN type = 'ExecutionFailed.v1' AND has_failed THEN 'the failure is detected twice'
            WHEN type = 'ExecutionFailed.v1' THEN NULL
            WHEN NOT has_failed THEN 'recovery before the failure is detected'
            WHEN is_resolved THEN 'recovery goes on after the failure is resolved'
            WHEN coalesce(rank, 0) <> reached
                THEN 'recovery acts at level ' || coalesce(level, 'unknown') || ' while it is at ' || list_extract(['local', 'peer', 'fleet', 'human'], reached)
            WHEN type = 'RecoveryAttempted.v1' AND time_us > deadline_us THEN 'an attempt begins after the time budget of its level'
            WHEN type = 'RecoveryEscalated.v1' AND coalesce(to_rank, 0) <> rank + 1
                THEN 'recovery goes from ' || level || ' to ' || coalesce(to_level, 'an unknown level') || ', not one level outward'
        END AS found
    FROM placed
)

SELECT
    run_id,
    seq,
    time_us,
    type,
    action_id,
    'failure ' || failure || ': ' || found AS found
FROM judged
WHERE found IS NOT NULL
