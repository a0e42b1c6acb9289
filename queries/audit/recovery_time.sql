-- Title: The time that each failure spent at each level of recovery
-- Paper: eq:recovery
-- Grain: one row per move of a failure's recovery to a level
-- Key: run_id, action_id, failure, move
-- Units: entered_us, left_us microseconds of run time; spent_us microseconds; attempts count; the first level counts
--   from detection
-- NULL: left_because where nothing followed or the record does not give it; left_us, spent_us when the failure was
--   still at this level at the end of its record; entered_us, spent_us of the first level when the failure itself is
--   not on record; all three also as facts/recovery_stays says; attempts when no attempt, is_resolved_here when no end,
--   is on record and the run does not observe recovery
-- Example: fsar-ledger query audit/recovery_time LEDGER --param run=RUN --param action=A1-1/4.1
--   answers local 4.101 s with 2 attempts (budget exhausted), peer 0.065 s, fleet 0.515 s, human 40.066 s, where it was
--   resolved
-- Parameters: run: run = all, action: action = all
SELECT
    stays.run_id, stays.action_id, stays.failure, stays.move, stays.level, stays.entered_us, stays.left_us,
    stays.left_us - stays.entered_us AS spent_us,
    nullif(count(attempts.seq), if(any_value(list_contains(runs.observes, 'recovery')), NULL, 0)) AS attempts,
    CASE
        WHEN stays.resolved_us >= stays.time_us AND coalesce(stays.resolved_us < stays.next_us, TRUE) THEN TRUE
        WHEN stays.next_seq IS NOT NULL OR list_contains(runs.observes, 'recovery') THEN FALSE
    END AS is_resolved_here,
    stays.left_because
FROM recovery_stays AS stays
INNER JOIN runs ON stays.run_id = runs.run_id
LEFT JOIN recovery_attempted AS attempts
    ON
        stays.run_id = attempts.run_id AND stays.action_id = attempts.failed_action AND stays.failure = attempts.failure
        AND stays.seq <= attempts.seq AND attempts.seq < coalesce(stays.next_seq, attempts.seq + 1)
WHERE $run IN ('all', stays.run_id) AND $action IN ('all', stays.action_id)
GROUP BY ALL
