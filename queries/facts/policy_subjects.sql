-- Title: Robots whose policy can be queried: fleet members, and in runs that record policy all that are named
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot and scope (its own policy, the fleet's for it)
-- Key: run_id, robot, scope
-- Units: none
-- NULL: never; is_member is whether a record says that the robot joined
-- Example: fsar-ledger query facts/policy_subjects LEDGER
WITH telling AS (
    SELECT run_id FROM policy_events
    UNION
    SELECT run_id FROM policies_told
    UNION
    SELECT run_id FROM runs
    WHERE list_contains(observes, 'policy')
),

robots AS (
    SELECT run_id, robot, TRUE AS is_member FROM fleet_members
    UNION ALL
    SELECT run_id, robot, FALSE AS is_member FROM policies_told
    UNION ALL
    SELECT run_id, robot, FALSE AS is_member FROM event_principals
    WHERE robot IS NOT NULL AND run_id IN (SELECT run_id FROM telling)
)

SELECT
    run_id, robot,
    unnest(['local', 'fleet']) AS scope,
    bool_or(is_member) AS is_member
FROM robots
GROUP BY run_id, robot
