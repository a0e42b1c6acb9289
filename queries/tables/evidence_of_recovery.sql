-- Title: What shows layered recovery: who begins it, which levels it reaches, and whether one is skipped
-- Paper: tab:baseline_context, eq:recovery
-- Grain: one row per made_alike (as in run_groups) and part
-- Key: made_alike, part
-- Units: numerator, denominator counts; of the levels, those that any failure came to and all four
-- NULL: never; no row for runs without failures, and none of runs that do not observe what a part rests on
-- Example: fsar-ledger query tables/evidence_of_recovery LEDGER
-- Stored: planned together with the other two, DuckDB would take longer to plan than to compute
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
        runs.run_id, runs.made_alike,
        -- By the robot that failed, or an agent in it: agent/A1/execution is a part of robot/A1.
        coalesce(
            first_steps.decided_by = failures.robot
            OR starts_with(first_steps.decided_by, 'agent/' || failures.robot[7:] || '/'),
            FALSE
        ) AS is_own,
        coalesce(moves.is_outward, FALSE) AS is_outward
    FROM failures
    INNER JOIN run_groups AS runs ON failures.run_id = runs.run_id
    LEFT JOIN first_steps
        ON
            failures.run_id = first_steps.run_id AND failures.action_id = first_steps.action_id
            AND failures.failure = first_steps.failure
    LEFT JOIN moves
        ON failures.run_id = moves.run_id AND failures.action_id = moves.action_id AND failures.failure = moves.failure
),

parts AS (
    SELECT
        run_id, made_alike,
        unnest([
            { 'part': 'failures that the robot itself begins to recover', 'holds': is_own },
            { 'part': 'failures that skip no level', 'holds': is_outward }
        ]) AS fact
    FROM judged
)

SELECT
    parts.made_alike,
    parts.fact.part,
    count(*) FILTER (parts.fact.holds) AS numerator,
    count(*) AS denominator
FROM parts
LEFT JOIN unobservable AS hidden ON parts.run_id = hidden.run_id AND parts.fact.part = hidden.judge
WHERE hidden.run_id IS NULL
GROUP BY ALL
UNION ALL
SELECT
    runs.made_alike,
    'levels of recovery in use' AS part,
    count(DISTINCT recovery_moves.level) AS numerator,
    4 AS denominator
FROM recovery_moves
INNER JOIN run_groups AS runs ON recovery_moves.run_id = runs.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'levels of recovery in use'
WHERE hidden.run_id IS NULL
GROUP BY runs.made_alike
