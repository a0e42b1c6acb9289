-- Title: Escalations that skipped a level of recovery, or went back to an earlier one
-- Paper: eq:recovery, sec:model:invariants (I4)
-- Grain: one row per move of recovery that is not to the next outward level; where a run does not record attempts and
--   escalations, only per escalation that names such a move itself
-- Key: run_id, action_id, failure, seq
-- Units: time_us microseconds of run time
-- NULL: from_level when recovery did not begin at the first level; decided_by when the record names no decider; reason
--   when it gives none
-- Example: fsar-ledger query audit/skipped_levels LEDGER --param run=RUN
--   answers A1-1/8.2: from local to human, left out peer and fleet, decided by agent/A1/execution
-- Parameters: run: run = all
SELECT
    run_id, action_id, failure, seq, time_us, type, decided_by, from_level,
    level AS to_level,
    list_slice(['local', 'peer', 'fleet', 'human'], coalesce(from_rank, 0) + 1, rank - 1) AS skipped,
    coalesce(rank < from_rank, FALSE) AS is_backwards,
    reason
FROM recovery_moves AS moves
SEMI JOIN run_started AS runs
    ON
        moves.run_id = runs.run_id
        AND (
            moves.type = 'RecoveryEscalated.v1' OR list_contains(runs.observes, 'recovery')
            OR list_has_all(runs.records, ['RecoveryAttempted', 'RecoveryEscalated'])
        )
WHERE rank <> coalesce(from_rank, 0) + 1 AND $run IN ('all', run_id)
