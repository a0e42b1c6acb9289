-- Title: Evidence on principals and deciders: robots as one principal, central decisions, agents inside robots,
--   attribution
-- Paper: tab:baseline_context, sec:model:invariants (I1, I5)
-- Grain: one row per run and part
-- Key: run_id, part
-- Units: numerator, denominator counts
-- NULL: never; no row for a part that nothing in the run could show, or that it does not observe
-- Example: fsar-ledger query tables/evidence_of_principals LEDGER
-- Partial: the rows of a run do not depend on other runs
-- Stored: together with the other two, it takes DuckDB longer to plan than to compute
WITH named AS (
    SELECT DISTINCT
        run_id,
        unnest(list_concat([decided_by, requested_by, executed_by, claimant, sender, receiver], coalesce(path, [])))
            AS principal
    FROM event_principals
),

robots AS (
    -- agent/A1/planning is a part of robot/A1. A robot that no record names shows nothing.
    SELECT
        members.run_id,
        count(DISTINCT named.principal) FILTER (named.principal <> members.robot) AS parts
    FROM fleet_members AS members
    INNER JOIN named
        ON
            members.run_id = named.run_id
            AND (
                members.robot = named.principal
                OR starts_with(named.principal, 'agent/' || members.robot[7:] || '/')
            )
    GROUP BY members.run_id, members.robot
),

assignments AS (
    -- Decisions on which robot does what for another, by decider where it is no robot, agent or human.
    SELECT
        run_id,
        CASE WHEN regexp_matches(decided_by, '^(robot|agent|supervisor)/') THEN NULL ELSE decided_by END AS centre,
        count(*) AS decisions
    FROM decisions
    WHERE decision_kind IN ('admission', 'delegation', 'commit')
    GROUP BY ALL
),

busiest AS (
    SELECT
        run_id,
        coalesce(max(decisions) FILTER (centre IS NOT NULL), 0) AS central,
        sum(decisions) AS decisions
    FROM assignments
    GROUP BY run_id
),

counted AS (
    SELECT run_id, 'robots that appear as one principal' AS part, (parts = 0)::INT AS numerator, 1 AS denominator
    FROM robots
    UNION ALL
    SELECT run_id, 'robots with two or more agents' AS part, (parts > 1)::INT AS numerator, 1 AS denominator
    FROM robots
    UNION ALL
    SELECT
        run_id, 'assignments decided by one principal that is no robot' AS part,
        central AS numerator, decisions AS denominator
    FROM busiest
    UNION ALL
    SELECT run_id, 'records with origin, executor and supervisor' AS part, numerator, denominator
    FROM audit_attributability
    WHERE denominator > 0
)

SELECT
    counted.run_id, counted.part,
    sum(counted.numerator)::BIGINT AS numerator,
    sum(counted.denominator)::BIGINT AS denominator
FROM counted
LEFT JOIN unobservable AS hidden ON counted.run_id = hidden.run_id AND counted.part = hidden.judge
WHERE hidden.run_id IS NULL
GROUP BY ALL
