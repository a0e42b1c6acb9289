-- Title: The stays of each failure's recovery at its levels, and when each began and ended
-- Paper: eq:recovery
-- Grain: one row per move of a failure's recovery to a level
-- Key: run_id, action_id, failure, move
-- Units: entered_us, left_us, next_us, resolved_us microseconds of run time; the first level counts from detection;
--   seq, next_seq positions in the run of this move and the next; rank 1 local to 4 human
-- NULL: robot, resolved_us when the record does not name it; next_us, next_seq, left_because where no move followed;
--   left_because also where the record does not give it; left_us when the failure was still at this level at the end of
--   its record; entered_us of the first level when the failure itself is not on record; both also where the run records
--   neither recovery nor attempts and escalations, unless an escalation, a failure or its resolution says when it was
-- Example: fsar-ledger query facts/recovery_stays LEDGER
WITH told AS (
    SELECT
        run_id,
        list_contains(observes, 'recovery')
        OR coalesce(list_has_all(records, ['RecoveryAttempted', 'RecoveryEscalated']), FALSE) AS tells_moves
    FROM run_started
)

SELECT
    moves.run_id, moves.action_id, moves.failure, moves.move, moves.level, moves.rank, moves.seq, failures.robot,
    CASE
        WHEN tells_moves AND moves.move > 1 OR moves.from_level IS NOT NULL AND failures.detected_us IS NULL
            THEN moves.time_us
        WHEN tells_moves OR moves.level = 'local' AND moves.move = 1 THEN failures.detected_us
        WHEN moves.type = 'RecoveryEscalated.v1' THEN moves.time_us
    END AS entered_us,
    CASE
        -- A level that recovery reaches after the resolution does not end with it.
        WHEN lead(moves.seq) OVER by_failure IS NULL
            THEN if(failures.resolved_us < moves.time_us, NULL, failures.resolved_us)
        WHEN tells_moves OR lead(moves.type) OVER by_failure = 'RecoveryEscalated.v1'
            THEN lead(moves.time_us) OVER by_failure
    END AS left_us,
    moves.time_us,
    lead(moves.seq) OVER by_failure AS next_seq,
    lead(moves.time_us) OVER by_failure AS next_us,
    lead(moves.reason) OVER by_failure AS left_because,
    failures.resolved_us
FROM recovery_moves AS moves
INNER JOIN told ON moves.run_id = told.run_id
LEFT JOIN failures_on_record AS failures
    ON moves.run_id = failures.run_id AND moves.action_id = failures.action_id AND moves.failure = failures.failure
WINDOW by_failure AS (PARTITION BY moves.run_id, moves.action_id, moves.failure ORDER BY moves.seq)
