-- Title: I4 broken: recovery of a failure skips a level, goes back, overruns a level's budget, or is resolved where
--   nothing was done
-- Paper: sec:model:invariants (I4), eq:recovery
-- Grain: one row per recovery event whose level is not the one reached, whose step is not to the next outward level,
--   that exceeds the time or the count of its level, or that rests on an event that is not on record
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query invariants/i4_outward_recovery LEDGER
-- A level's time runs from when recovery turned to it. At the local level the first attempt must begin within that time
-- after the failure, and the time then runs from that attempt. Help that was requested in time may end later. Each call
-- to a human has its own time. Without a recorded budget none is overrun.
WITH placed AS (
    -- Every failure begins at the local level. Every escalation sets the level for later events, even a wrong one.
    SELECT
        run_id, seq, time_us, type, action_id, helper, deadline_us, reason, to_level, level, failure, rank, to_rank,
        t_max_us, n_max, is_use,
        coalesce(last_value(to_rank IGNORE NULLS) OVER earlier, 1) AS reached,
        last_value(CASE WHEN type IN ('ExecutionFailed.v1', 'RecoveryEscalated.v1') THEN time_us END IGNORE NULLS)
            OVER earlier AS reached_us,
        coalesce(bool_or(type = 'ExecutionFailed.v1') OVER earlier, FALSE) AS has_failed,
        coalesce(bool_or(type = 'FailureResolved.v1') OVER earlier, FALSE) AS is_resolved,
        max(CASE WHEN is_remedy THEN rank END) OVER earlier AS remedy_rank,
        first_value(CASE WHEN type = 'RecoveryAttempted.v1' THEN time_us + t_max_us END IGNORE NULLS)
            OVER so_far AS attempts_end_us,
        sum(is_use::INTEGER) OVER (PARTITION BY run_id, action_id, failure, level ORDER BY seq) AS uses,
        coalesce(bool_or(type = 'AssistanceRequested.v1') OVER of_helper, FALSE) AS is_asked
    FROM recovery_acts
    WINDOW
        earlier AS (
            PARTITION BY run_id, action_id, failure ORDER BY seq ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
        ),
        so_far AS (PARTITION BY run_id, action_id, failure ORDER BY seq ROWS UNBOUNDED PRECEDING),
        of_helper AS (PARTITION BY run_id, action_id, failure, helper ORDER BY seq)
),

judged AS (
    SELECT
        run_id, seq, time_us, type, action_id, failure,
        CASE
            WHEN level = 'local' AND uses > 1 THEN attempts_end_us WHEN level <> 'human' THEN reached_us + t_max_us
        END AS ends_us,
        CASE
            WHEN type = 'ExecutionFailed.v1' AND has_failed THEN 'the failure is detected twice'
            WHEN type IN ('ExecutionFailed.v1', 'SupervisorResponded.v1') THEN NULL
            WHEN NOT has_failed THEN 'recovery before the failure is detected'
            WHEN is_resolved THEN 'recovery goes on after the failure is resolved'
            WHEN coalesce(rank, 0) <> reached
                THEN
                    'recovery acts at level ' || coalesce(level, 'unknown') || ' while it is at '
                    || list_extract(['local', 'peer', 'fleet', 'human'], reached)
            WHEN is_use AND uses > n_max
                THEN 'use ' || uses || ' of level ' || level || ', which has a budget of ' || n_max
            WHEN type = 'RecoveryAttempted.v1' AND deadline_us > attempts_end_us
                THEN 'an attempt takes more time for itself than the budget of its level'
            WHEN type = 'RecoveryAttempted.v1' AND time_us > least(deadline_us, ends_us)
                THEN 'an attempt begins after the time budget of its level'
            WHEN type IN ('AssistanceRequested.v1', 'ReassignmentDecided.v1') AND time_us > ends_us
                THEN 'recovery acts after the time budget of its level'
            WHEN type = 'AssistanceAdmitted.v1' AND NOT is_asked
                THEN 'help by ' || coalesce(helper, 'nobody') || ', who had not been asked'
            WHEN type = 'FailureResolved.v1' AND coalesce(remedy_rank, 0) <> rank
                THEN 'resolved at level ' || level || ', where nothing was done'
            WHEN type = 'RecoveryEscalated.v1' AND coalesce(to_rank, 0) <> rank + 1
                THEN
                    'recovery goes from ' || level || ' to ' || coalesce(to_level, 'an unknown level')
                    || ', not one level outward'
            WHEN
                type = 'RecoveryEscalated.v1' AND level <> 'local' AND coalesce(reason, '') <> 'budget exhausted'
                AND time_us > ends_us
                THEN 'recovery stays at level ' || level || ' after the time budget of its level'
        END AS found
    FROM placed
)

SELECT
    run_id, seq, time_us, type, action_id,
    'failure ' || coalesce(failure::VARCHAR, 'unknown') || ': ' || found AS found
FROM judged
WHERE found IS NOT NULL
