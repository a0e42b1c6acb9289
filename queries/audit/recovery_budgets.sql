-- Title: How much of its budget each failure used at each level of recovery
-- Paper: eq:recovery, app:foundations (Paper 3)
-- Grain: one row per failure and level that its recovery reached
-- Key: run_id, action_id, failure, level
-- Units: spent_us, t_max_us microseconds, spent_us including the time of the help; used, n_max attempts (local),
--   helpers asked (peer), reassignments and ordered help (fleet), calls (human); rank 1 local to 4 human
-- NULL: spent_us when the failure was still at this level at the end of its record, of the first level when the
--   failure itself is not on record, and where facts/recovery_stays lacks a time; t_max_us, n_max where the run records
--   neither; set_by where the budget is the fleet's own; used when none is on record and the run does not observe
--   recovery (of level human: supervision)
-- Example: fsar-ledger query audit/recovery_budgets LEDGER --param run=RUN --param action=A1-1/2.1
--   answers local 2 of 2 attempts, peer 0 of 1 helpers, fleet 0 of 1 reassignments, human 1 of 2 calls
-- Parameters: run: run = all, action: action = all
WITH levels AS (
    -- Recovery that returns to a level spends the rest of its budget.
    SELECT
        run_id, action_id, failure, level, rank, robot,
        min(seq) AS seq,
        if(count(*) = count(left_us - entered_us), sum(left_us - entered_us)::BIGINT, NULL) AS spent_us
    FROM recovery_stays
    WHERE $run IN ('all', run_id) AND $action IN ('all', action_id)
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
