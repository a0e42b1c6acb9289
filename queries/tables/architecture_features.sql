-- Title: Architectural comparison: which of the eight features each architecture of the ledger shows, by what its events say
-- Paper: tab:baseline_context
-- Grain: one row per architecture, configuration and feature
-- Units: essential_share share; evidence is text, numerator/denominator of each part, the essential one first
-- NULL: grade, essential_share when the ledger holds nothing that could show the essential part; grade also when another part that would decide is not shown
-- Example: fsar-ledger query tables/architecture_features LEDGER
--   answers cfc trust_scoped_delegation none: untrusted delegations that went through trusted links 0/40; outsiders refused 40/40
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

evidence AS (
    SELECT * FROM evidence_of_principals
    UNION ALL
    SELECT * FROM evidence_of_governance
    UNION ALL
    SELECT * FROM evidence_of_recovery
),

groups AS (
    SELECT
        runs.architecture,
        runs.configuration,
        array_agg(DISTINCT hidden.judge) AS unseen
    FROM runs
    LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id
    GROUP BY runs.architecture, runs.configuration
),

shares AS (
    SELECT
        groups.architecture,
        groups.configuration,
        rules.*,
        evidence.numerator / evidence.denominator AS share,
        rules.part || ' ' || coalesce(
            evidence.numerator || '/' || evidence.denominator, if(list_contains(groups.unseen, rules.part), 'not observable', 'not shown')
        ) AS shown
    FROM groups
    CROSS JOIN rules
    LEFT JOIN evidence
        ON
            groups.architecture IS NOT DISTINCT FROM evidence.architecture AND groups.configuration IS NOT DISTINCT FROM evidence.configuration
            AND rules.part = evidence.part
)

-- One rule grades all eight, and never looks at the architecture's name. Each feature has parts, each a share of events; one part is essential.
-- full: every part holds in at least 0.95 of its cases. none: the essential part holds in fewer than 0.70. partial: anything between.
-- The thresholds are ours, as the paper gives none. 0.95: at most one case in twenty escapes the mechanism. 0.70: the mechanism governs more than twice as
-- many cases as it misses; with less, it is what happens, not what rules.
SELECT
    architecture,
    configuration,
    feature,
    CASE
        WHEN min(share) FILTER (is_essential) < 0.7 THEN 'none'
        WHEN count(share) FILTER (is_essential) = 0 THEN NULL
        WHEN min(share) < 0.95 THEN 'partial'
        WHEN count(share) = count(*) THEN 'full'
    END AS grade,
    min(share) FILTER (is_essential) AS essential_share,
    string_agg(shown, '; ' ORDER BY is_essential DESC, part ASC) AS evidence
FROM shares
GROUP BY architecture, configuration, feature
