-- Title: What each failure used of the budget that its robot had at each level of recovery
-- Paper: eq:recovery, app:foundations (Paper 3)
-- Grain: one row per failure and level that its recovery turned to
-- Key: run_id, action_id, failure, level
-- Units: spent_us, t_max_us microseconds, spent_us with the time of the help; used, n_max attempts (local), helpers
--   asked (peer), reassignments (fleet), calls (human); rank 1 local to 4 human
-- NULL: spent_us when the failure was still at this level at the end of its record; t_max_us, n_max where the run
--   records neither; set_by where the budget is the fleet's own; used of level human when the run does not observe
--   supervision
-- Example: fsar-ledger query audit/recovery_budgets LEDGER --param run=RUN --param action=A1-1/2.1
--   answers local 2 of 2 attempts, peer 0 of 1 helpers, fleet 0 of 1 reassignments, human 1 of 2 calls
-- Parameters: run: run = all, action: action = all
WITH stays AS (
    SELECT
        moves.run_id, moves.action_id, moves.failure, moves.level, moves.rank, moves.seq, failures.robot,
        lead(moves.seq) OVER by_failure AS next_seq,
        coalesce(lead(moves.time_us) OVER by_failure, failures.resolved_us)
        - CASE moves.move WHEN 1 THEN failures.detected_us ELSE moves.time_us END AS spent_us
    FROM recovery_moves AS moves
    INNER JOIN failures
        ON moves.run_id = failures.run_id AND moves.action_id = failures.action_id AND moves.failure = failures.failure
    WHERE $run IN ('all', moves.run_id) AND $action IN ('all', moves.action_id)
    WINDOW by_failure AS (PARTITION BY moves.run_id, moves.action_id, moves.failure ORDER BY moves.seq)
),

used AS (
    SELECT
        stays.run_id, stays.action_id, stays.failure, stays.level, stays.rank, stays.seq, stays.robot, stays.next_seq,
        stays.spent_us,
        count(uses.seq) AS used
    FROM stays
    LEFT JOIN recovery_acts AS uses
        ON
            uses.is_use AND stays.run_id = uses.run_id AND stays.action_id = uses.action_id AND stays.level = uses.level
            AND stays.seq <= uses.seq AND uses.seq < coalesce(stays.next_seq, uses.seq + 1)
    GROUP BY ALL
)

SELECT
    used.run_id, used.action_id, used.failure, used.rank, used.level, used.robot, used.spent_us, allowed.t_max_us,
    if(used.level <> 'human' OR list_contains(runs.observes, 'supervision'), used.used, NULL) AS used,
    allowed.n_max, allowed.set_by
FROM used
INNER JOIN runs ON used.run_id = runs.run_id
ASOF LEFT JOIN recovery_allowances AS allowed
    ON
        used.run_id = allowed.run_id AND used.robot = allowed.robot AND used.level = allowed.level
        AND used.seq >= allowed.since_seq
