-- Title: What shows who a principal is and who decides: robots as one principal, central decisions, agents inside
--   robots, attribution
-- Paper: tab:baseline_context, sec:model:invariants (I1, I5)
-- Grain: one row per made_alike (as in run_groups) and part
-- Key: made_alike, part
-- Units: numerator, denominator counts
-- NULL: never; no row for a part that nothing in the ledger could show, and none of runs that do not observe what it
--   rests on
-- Example: fsar-ledger query tables/evidence_of_principals LEDGER
-- Stored: in one plan with the other two, DuckDB plans longer than it computes
WITH named AS (
    SELECT DISTINCT
        run_id,
        unnest(list_concat([decided_by, requested_by, executed_by, claimant, sender, receiver], coalesce(path, [])))
            AS principal
    FROM event_principals
),

robots AS (
    -- agent/A1/planning is a part of robot/A1.
    SELECT
        fleet_members.run_id,
        count(DISTINCT named.principal) AS parts
    FROM fleet_members
    LEFT JOIN named
        ON
            fleet_members.run_id = named.run_id
            AND starts_with(named.principal, 'agent/' || fleet_members.robot[7:] || '/')
    GROUP BY fleet_members.run_id, fleet_members.robot
),

assignments AS (
    -- Who decides which robot does what for another: neither the robot, nor an agent in it, nor a human.
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
    SELECT
        {
            'run_id': run_id, 'part': 'robots that appear as one principal', 'numerator': (parts = 0)::INT,
            'denominator': 1
        } AS fact
    FROM robots
    UNION ALL
    SELECT
        {
            'run_id': run_id, 'part': 'robots with two or more agents', 'numerator': (parts > 1)::INT, 'denominator': 1
        } AS fact
    FROM robots
    UNION ALL
    SELECT
        {
            'run_id': run_id, 'part': 'assignments decided by one principal that is no robot', 'numerator': central,
            'denominator': decisions
        } AS fact
    FROM busiest
    UNION ALL
    SELECT
        {
            'run_id': run_id, 'part': 'records with origin, executor and supervisor', 'numerator': numerator,
            'denominator': denominator
        } AS fact
    FROM audit_attributability
    WHERE denominator > 0
)

SELECT
    runs.made_alike,
    counted.fact.part,
    sum(counted.fact.numerator)::BIGINT AS numerator,
    sum(counted.fact.denominator)::BIGINT AS denominator
FROM run_groups AS runs
INNER JOIN counted ON runs.run_id = counted.fact.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND counted.fact.part = hidden.judge
WHERE hidden.run_id IS NULL
GROUP BY ALL
