-- Title: The candidates of a query, and why each other robot was none, by visibility and trust as of then
-- Paper: sec:architecture:registry, eq:adv, eq:trust
-- Grain: one row per RegistryQueried event and other robot of the fleet
-- Units: time_us microseconds of run time
-- NULL: trust_scope when the robot had not set any for the requester; relay when the query was answered without one;
--   action_id when the query is tied to no action
-- Example: fsar-ledger query audit/query_candidates LEDGER --param run=RUN --param action=injected-1-2
--   answers robot/A1 does not offer it, robot/B1 does not offer it, robot/C1 not visible to role D
-- Parameters: run = all, action = all
WITH asked AS (
    SELECT
        queries.run_id,
        queries.seq,
        queries.time_us,
        queries.action_id,
        queries.requested_by,
        queries.capability,
        queries.candidates,
        queries.relay,
        requesters.role,
        runs.configuration = 'without-shared-registry' AS is_by_meeting
    FROM registry_queried AS queries
    INNER JOIN runs ON queries.run_id = runs.run_id
    LEFT JOIN robot_joined AS requesters ON queries.run_id = requesters.run_id AND queries.requested_by = requesters.robot
    WHERE $run IN ('all', queries.run_id) AND $action IN ('all', queries.action_id)
),

considered AS (
    SELECT
        asked.*,
        others.robot,
        arg_max(offers.visible_to, offers.seq) AS visible_to,
        arg_max(trust.scope, trust.seq) AS trust_scope
    FROM asked
    INNER JOIN robot_joined AS others ON asked.run_id = others.run_id AND asked.requested_by <> others.robot AND asked.seq > others.seq
    LEFT JOIN capability_advertised AS offers
        ON asked.run_id = offers.run_id AND others.robot = offers.robot AND asked.capability = offers.capability AND asked.seq > offers.seq
    LEFT JOIN trust_set AS trust
        ON asked.run_id = trust.run_id AND others.robot = trust.robot AND asked.requested_by = trust.peer AND asked.seq > trust.seq
    GROUP BY ALL
)

SELECT
    run_id,
    seq,
    time_us,
    action_id,
    requested_by,
    capability,
    robot,
    list_contains(candidates, robot) AS is_candidate,
    trust_scope,
    relay,
    CASE
        WHEN list_contains(candidates, robot) AND relay IS NOT NULL THEN 'candidate through ' || relay
        WHEN list_contains(candidates, robot) THEN 'candidate'
        WHEN visible_to IS NULL THEN 'does not offer it'
        WHEN len(visible_to) > 0 AND NOT coalesce(list_contains(visible_to, role), FALSE) THEN 'not visible to role ' || coalesce(role, 'unknown')
        WHEN coalesce(trust_scope, 'none') = 'none' THEN 'no trust in the requester'
        WHEN is_by_meeting THEN 'not met lately'
        ELSE 'the record gives no reason'
    END AS reason
FROM considered
