-- Title: Recorded absences of supervisors
-- Paper: eq:supervision
-- Grain: one row per SupervisorLeft event
-- Key: run_id, left_seq
-- Units: left_us, returned_us microseconds of run time; left_seq, returned_seq positions in the run
-- NULL: returned_us and returned_seq when the supervisor never came back
-- Example: fsar-ledger query facts/supervisor_absences LEDGER
WITH shifts AS (
    SELECT
        run_id, seq, time_us, type, supervisor,
        first_value(CASE WHEN type = 'SupervisorReturned.v1' THEN seq END IGNORE NULLS) OVER later AS returned_seq,
        first_value(CASE WHEN type = 'SupervisorReturned.v1' THEN time_us END IGNORE NULLS) OVER later AS returned_us
    FROM supervision_events
    WHERE type IN ('SupervisorLeft.v1', 'SupervisorReturned.v1')
    WINDOW later AS (PARTITION BY run_id, supervisor ORDER BY seq ROWS BETWEEN 1 FOLLOWING AND UNBOUNDED FOLLOWING)
)

SELECT run_id, supervisor, seq AS left_seq, returned_seq, time_us AS left_us, returned_us
FROM shifts
WHERE type = 'SupervisorLeft.v1'
