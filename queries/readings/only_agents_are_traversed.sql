-- Title: A robot's or supervisor's decision is local unless agents inside a robot are on its path
-- Paper: sec:evaluation:metrics
-- Reading: R4
-- Question: what may be on the path of a local decision
-- Replaces: decisions
-- Moves: governance_locality
-- Why: The definition excludes the traversal of nested internal-agent delegation chains, and of nothing else; that of
--   the fleet layer stands in the worked computation.
-- Grain: one row per decision
-- Key: run_id, seq
-- Units: as in decisions
-- NULL: as in decisions
-- Example: fsar-ledger query readings/only_agents_are_traversed LEDGER
SELECT
    * REPLACE (
        is_local OR coalesce(
            len(path) > 0 AND (starts_with(decided_by, 'robot/') OR starts_with(decided_by, 'supervisor/'))
            AND len(list_filter(path, LAMBDA one: starts_with(one, 'agent/'))) = 0,
            FALSE
        ) AS is_local
    )
FROM decisions
