-- Title: Evidence for the eight features of the architectural comparison, part by part
-- Paper: tab:baseline_context
-- Grain: one row per made_alike (as in run_groups), feature and part
-- Key: made_alike, feature, part
-- Units: share; shown is text, the part with its numerator/denominator
-- NULL: share when nothing in the runs could show the part, or they do not observe what it rests on
-- Example: fsar-ledger query tables/feature_parts LEDGER
WITH rules (feature, part, is_essential) AS (
    VALUES
    ('single_agent_robot', 'robots that appear as one principal', TRUE),
    ('centralized_coordination', 'assignments decided by one principal that is no robot', TRUE),
    ('intra_robot_agents', 'robots with two or more agents', TRUE),
    ('trust_scoped_delegation', 'untrusted delegations that went through trusted links', TRUE),
    ('trust_scoped_delegation', 'outsiders refused', FALSE),
    ('layered_recovery', 'failures that the robot itself begins to recover', TRUE),
    ('layered_recovery', 'failures that skip no level', FALSE),
    ('layered_recovery', 'levels of recovery in use', FALSE),
    ('policy_composition', 'decisions on the executor''s policy', TRUE),
    ('policy_composition', 'the requester''s policy heeded', FALSE),
    ('policy_composition', 'the fleet''s rule heeded', FALSE),
    ('governed_registry', 'delegations found beyond the peers that were met', TRUE),
    ('governed_registry', 'hidden capabilities kept from outsiders', FALSE),
    ('audit_attribution', 'records with origin, executor and supervisor', TRUE)
),

counted AS (
    SELECT run_id, part, NULL AS level, numerator, denominator FROM evidence_of_principals
    UNION ALL
    SELECT run_id, part, NULL AS level, numerator, denominator FROM evidence_of_governance
    UNION ALL
    SELECT run_id, part, level, numerator, denominator FROM evidence_of_recovery
),

evidence AS (
    -- A level reached by several runs counts once among the four.
    SELECT
        runs.made_alike, counted.part,
        if(count(counted.level) > 0, count(DISTINCT counted.level), sum(counted.numerator))::BIGINT AS numerator,
        if(count(counted.level) > 0, max(counted.denominator), sum(counted.denominator))::BIGINT AS denominator
    FROM run_groups AS runs
    INNER JOIN counted ON runs.run_id = counted.run_id
    GROUP BY ALL
),

groups AS (
    SELECT
        runs.made_alike,
        array_agg(DISTINCT hidden.judge) AS unseen
    FROM run_groups AS runs
    LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id
    GROUP BY runs.made_alike
)

SELECT
    groups.made_alike, rules.feature, rules.part, rules.is_essential,
    evidence.numerator / evidence.denominator AS share,
    rules.part || ' ' || coalesce(
        evidence.numerator || '/' || evidence.denominator,
        if(list_contains(groups.unseen, rules.part), 'not observable', 'not shown')
    ) AS shown
FROM groups
CROSS JOIN rules
LEFT JOIN evidence ON groups.made_alike = evidence.made_alike AND rules.part = evidence.part
