-- Title: The time that each failure spent at each level of recovery
-- Paper: eq:recovery
-- Grain: one row per move of a failure's recovery to a level
-- Key: run_id, action_id, failure, move
-- Units: entered_us, left_us microseconds of run time; spent_us microseconds; attempts count; the first level counts
--   from detection
-- NULL: left_because where nothing followed or the record does not give it; left_us, spent_us when the failure was
--   still at this level at the end of its record; entered_us, spent_us of the first level when the failure itself is
--   not on record; attempts when no attempt, is_resolved_here when no end, is on record and the run does not observe
--   recovery
-- Example: fsar-ledger query audit/recovery_time LEDGER --param run=RUN --param action=A1-1/4.1
--   answers local 4.101 s with 2 attempts (budget exhausted), peer 0.065 s, fleet 0.515 s, human 40.066 s, where it was
--   resolved
-- Parameters: run: run = all, action: action = all
WITH stays AS (
    SELECT
        moves.run_id, moves.action_id, moves.failure, moves.move, moves.level, moves.seq,
        CASE
            WHEN moves.move > 1 OR (failures.detected_us IS NULL AND moves.from_level IS NOT NULL) THEN moves.time_us
            ELSE failures.detected_us
        END AS entered_us,
        lead(moves.seq) OVER by_failure AS next_seq,
        lead(moves.reason) OVER by_failure AS left_because,
        -- A level that recovery reaches after the resolution does not end with it.
        coalesce(
            lead(moves.time_us) OVER by_failure,
            if(failures.resolved_us < moves.time_us, NULL, failures.resolved_us)
        ) AS left_us,
        CASE
            WHEN
                failures.resolved_us >= moves.time_us
                AND coalesce(failures.resolved_us < lead(moves.time_us) OVER by_failure, TRUE)
                THEN TRUE
            WHEN lead(moves.seq) OVER by_failure IS NOT NULL OR list_contains(runs.observes, 'recovery') THEN FALSE
        END AS is_resolved_here,
        if(list_contains(runs.observes, 'recovery'), NULL, 0) AS none_seen
    FROM recovery_moves AS moves
    INNER JOIN runs ON moves.run_id = runs.run_id
    LEFT JOIN failures_on_record AS failures
        ON moves.run_id = failures.run_id AND moves.action_id = failures.action_id AND moves.failure = failures.failure
    WHERE $run IN ('all', moves.run_id) AND $action IN ('all', moves.action_id)
    WINDOW by_failure AS (PARTITION BY moves.run_id, moves.action_id, moves.failure ORDER BY moves.seq)
)

SELECT
    stays.run_id, stays.action_id, stays.failure, stays.move, stays.level, stays.entered_us, stays.left_us,
    stays.left_us - stays.entered_us AS spent_us,
    nullif(count(attempts.seq), any_value(stays.none_seen)) AS attempts,
    stays.is_resolved_here, stays.left_because
FROM stays
LEFT JOIN recovery_attempted AS attempts
    ON
        stays.run_id = attempts.run_id AND stays.action_id = attempts.failed_action AND stays.failure = attempts.failure
        AND stays.seq <= attempts.seq AND attempts.seq < coalesce(stays.next_seq, attempts.seq + 1)
GROUP BY ALL
