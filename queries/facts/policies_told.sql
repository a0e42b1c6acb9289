-- Title: What deciders are told of policy: copies, snapshots, and rules of the fleet
-- Paper: eq:policy, sec:evaluation:baselines
-- Grain: one row per FleetRuleLearned and SnapshotTaken event, and per CopySynced event, scope and robot that is a
--   member of the fleet or named by any copy of the run
-- Key: run_id, seq, robot, scope
-- Units: learned_us, as_of_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query facts/policies_told LEDGER
WITH covered AS (
    SELECT run_id, robot FROM fleet_members
    UNION
    SELECT
        run_id,
        unnest(list_distinct(list_concat(local_deny, local_review, fleet_deny, fleet_review))) AS robot
    FROM copy_synced
),

copies AS (
    -- A copy covers every robot; for one that it does not name, policy allows.
    SELECT
        copies.run_id, copies.seq,
        copies.time_us AS learned_us,
        'coordinator' AS known_by,
        members.robot, scopes.scope,
        CASE
            WHEN list_contains(if(scopes.scope = 'local', copies.local_deny, copies.fleet_deny), members.robot)
                THEN 'deny'
            WHEN list_contains(if(scopes.scope = 'local', copies.local_review, copies.fleet_review), members.robot)
                THEN 'review'
            ELSE 'allow'
        END AS outcome,
        copies.time_us AS as_of_us
    FROM copy_synced AS copies
    INNER JOIN covered AS members ON copies.run_id = members.run_id
    CROSS JOIN (VALUES ('local'), ('fleet')) AS scopes (scope)
)

-- Deciders are told of windows. Rules are known to all at once; see audit/policy_at.
SELECT
    run_id, seq,
    time_us AS learned_us,
    CASE type WHEN 'FleetRuleLearned.v1' THEN robot ELSE 'agent/' || robot[7:] || '/planning' END AS known_by,
    robot,
    CASE type WHEN 'FleetRuleLearned.v1' THEN 'fleet' ELSE 'local' END AS scope,
    outcome,
    coalesce(as_of_us, time_us) AS as_of_us
FROM knowledge_events
WHERE type IN ('FleetRuleLearned.v1', 'SnapshotTaken.v1')
UNION ALL
SELECT *
FROM copies
