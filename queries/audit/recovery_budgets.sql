-- Title: How much of its budget each failure used at each level of recovery
-- Paper: eq:recovery, app:foundations (Paper 3)
-- Grain: one row per failure and level that its recovery reached
-- Key: run_id, action_id, failure, level
-- Units: spent_us, t_max_us microseconds, spent_us including the time of the help; used, n_max attempts (local),
--   helpers asked (peer), reassignments and ordered help (fleet), calls (human); rank 1 local to 4 human
-- NULL: spent_us when the failure was still at this level at the end of its record, and of the first level when the
--   failure itself is not on record; t_max_us, n_max where the run records neither; set_by where the budget is the
--   fleet's own; used when none is on record and the run does not observe recovery (of level human: supervision)
-- Example: fsar-ledger query audit/recovery_budgets LEDGER --param run=RUN --param action=A1-1/2.1
--   answers local 2 of 2 attempts, peer 0 of 1 helpers, fleet 0 of 1 reassignments, human 1 of 2 calls
-- Parameters: run: run = all, action: action = all
WITH stays AS (
    SELECT
        moves.run_id, moves.action_id, moves.failure, moves.level, moves.rank, moves.seq, failures.robot,
        coalesce(
            lead(moves.time_us) OVER by_failure,
            if(failures.resolved_us < moves.time_us, NULL, failures.resolved_us)
        )
        - CASE
            WHEN moves.move > 1 OR (failures.detected_us IS NULL AND moves.from_level IS NOT NULL) THEN moves.time_us
            ELSE failures.detected_us
        END AS spent_us
    FROM recovery_moves AS moves
    INNER JOIN failures_on_record AS failures
        ON moves.run_id = failures.run_id AND moves.action_id = failures.action_id AND moves.failure = failures.failure
    WHERE $run IN ('all', moves.run_id) AND $action IN ('all', moves.action_id)
    WINDOW by_failure AS (PARTITION BY moves.run_id, moves.action_id, moves.failure ORDER BY moves.seq)
),

levels AS (
    -- Recovery that returns to a level spends the rest of its budget.
    SELECT
        run_id, action_id, failure, level, rank, robot,
        min(seq) AS seq,
        if(count(*) = count(spent_us), sum(spent_us)::BIGINT, NULL) AS spent_us
    FROM stays
    GROUP BY run_id, action_id, failure, level, rank, robot
),

uses AS (
    SELECT run_id, action_id, failure, level, count(*) AS used
    FROM recovery_steps
    WHERE
        type IN ('RecoveryAttempted.v1', 'AssistanceRequested.v1', 'SupervisorCalled.v1')
        OR (type = 'ReassignmentDecided.v1' AND helper IS NOT NULL)
    GROUP BY run_id, action_id, failure, level
)

SELECT
    levels.run_id, levels.action_id, levels.failure, levels.rank, levels.level, levels.robot, levels.spent_us,
    allowed.t_max_us,
    coalesce(
        uses.used, if(list_contains(runs.observes, if(levels.level = 'human', 'supervision', 'recovery')), 0, NULL)
    ) AS used,
    allowed.n_max, allowed.set_by
FROM levels
INNER JOIN runs ON levels.run_id = runs.run_id
LEFT JOIN uses
    ON
        levels.run_id = uses.run_id AND levels.action_id = uses.action_id AND levels.failure = uses.failure
        AND levels.level = uses.level
ASOF LEFT JOIN recovery_allowances AS allowed
    ON
        levels.run_id = allowed.run_id AND levels.robot = allowed.robot AND levels.level = allowed.level
        AND levels.seq >= allowed.since_seq
