-- Title: Architectural comparison: which of the eight features the events of each architecture show
-- Paper: tab:baseline_context
-- Grain: one row per architecture, configuration, seed, setting (kind, source, model version, constants, fleet size)
--   and feature
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?, feature
-- Units: essential_share share; evidence is text, numerator/denominator of each part, the essential one first
-- NULL: dimensions that the runs lack; constants where all runs of the kind and model have the same; grade,
--   essential_share when nothing in the runs could show the essential part; grade also when another part that would
--   decide is not shown
-- Example: fsar-ledger query tables/architecture_features LEDGER
--   answers cfc trust_scoped_delegation none: untrusted delegations that went through trusted links 0/40; outsiders
--   refused 40/40
WITH alike AS (
    SELECT DISTINCT * EXCLUDE (run_id)
    FROM run_groups
)

-- One rule grades all eight and never looks at the architecture's name. Each feature has parts, each a share of
-- events; one part is essential. full: every part holds in at least 0.95 of its cases. none: the essential part holds
-- in fewer than 0.70. partial: anything between. The thresholds are ours, as the paper gives none. 0.95: at most one
-- case in twenty escapes the mechanism. 0.70: the mechanism governs more than twice as many cases as it misses; below
-- that, it occurs but does not govern.
SELECT
    runs.architecture, runs.configuration, runs.fleet_size, runs.seed, runs.kind, runs.source, runs.model_version,
    runs.constants, parts.feature,
    CASE
        WHEN min(parts.share) FILTER (parts.is_essential) < 0.7 THEN 'none'
        WHEN count(parts.share) FILTER (parts.is_essential) = 0 THEN NULL
        WHEN min(parts.share) < 0.95 THEN 'partial'
        WHEN count(parts.share) = count(*) THEN 'full'
    END AS grade,
    min(parts.share) FILTER (parts.is_essential) AS essential_share,
    string_agg(parts.shown, '; ' ORDER BY parts.is_essential DESC, parts.part ASC) AS evidence
FROM alike AS runs
INNER JOIN feature_parts AS parts ON runs.made_alike = parts.made_alike
GROUP BY ALL
