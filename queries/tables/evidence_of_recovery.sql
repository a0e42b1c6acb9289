-- Title: Evidence of layered recovery: who begins it, the levels it reaches, and whether one is skipped
-- Paper: tab:baseline_context, eq:recovery
-- Grain: one row per run and part, and for the levels in use one per level
-- Key: run_id, part, level?
-- Units: numerator, denominator counts; of the levels, this one and all four
-- NULL: level of the other parts; no row of a run without failures, nor for a part that it does not observe
-- Example: fsar-ledger query tables/evidence_of_recovery LEDGER
-- Partial: the rows of a run do not depend on other runs
-- Stored: together with the other two, it takes DuckDB longer to plan than to compute
WITH first_steps AS (
    SELECT
        run_id, action_id, failure,
        arg_min(decided_by, seq) AS decided_by
    FROM recovery_steps
    GROUP BY run_id, action_id, failure
),

moves AS (
    SELECT
        run_id, action_id, failure,
        bool_and(rank <= coalesce(from_rank, 0) + 1) AS is_outward
    FROM recovery_moves
    GROUP BY run_id, action_id, failure
),

judged AS (
    SELECT
        failures.run_id,
        -- By the robot that failed, or an agent in it: agent/A1/execution is a part of robot/A1.
        coalesce(
            first_steps.decided_by = failures.robot
            OR starts_with(first_steps.decided_by, 'agent/' || failures.robot[7:] || '/'),
            FALSE
        ) AS is_own,
        coalesce(moves.is_outward, FALSE) AS is_outward
    FROM failures
    LEFT JOIN first_steps
        ON
            failures.run_id = first_steps.run_id AND failures.action_id = first_steps.action_id
            AND failures.failure = first_steps.failure
    LEFT JOIN moves
        ON failures.run_id = moves.run_id AND failures.action_id = moves.action_id AND failures.failure = moves.failure
),

parts AS (
    SELECT
        run_id,
        unnest([
            { 'part': 'failures that the robot itself begins to recover', 'holds': is_own },
            { 'part': 'failures that skip no level', 'holds': is_outward }
        ]) AS fact
    FROM judged
),

counted AS (
    SELECT run_id, fact.part, NULL AS level, count(*) FILTER (fact.holds) AS numerator, count(*) AS denominator
    FROM parts
    GROUP BY ALL
    UNION ALL
    SELECT DISTINCT run_id, 'levels of recovery in use' AS part, level, 1 AS numerator, 4 AS denominator
    FROM recovery_moves
)

SELECT counted.*
FROM counted
LEFT JOIN unobservable AS hidden ON counted.run_id = hidden.run_id AND counted.part = hidden.judge
WHERE hidden.run_id IS NULL
