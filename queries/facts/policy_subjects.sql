-- Title: Whose policy can be asked for: the robots of a fleet, and those of which a decider was told
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot and scope (its own policy, the fleet's for it)
-- Key: run_id, robot, scope
-- Units: none
-- NULL: never
-- Example: fsar-ledger query facts/policy_subjects LEDGER
SELECT
    run_id, robot,
    unnest(['local', 'fleet']) AS scope
FROM fleet_members
UNION
SELECT run_id, robot, scope
FROM policies_told
