-- Title: Why each other robot was or was not a candidate of a query: the filter, else its surface, its trust or its
--   departure
-- Paper: sec:architecture:registry, eq:adv, eq:trust
-- Grain: one row per RegistryQueried event and other robot of the fleet
-- Key: run_id, seq, robot
-- Units: time_us, as_of_us microseconds of run time
-- NULL: rejected_by when the record names no filter for the robot; trust_scope when the robot had set none for the
--   requester; relay, action_id, task_id when the query had none; a cause or principal that the record does not name;
--   as_of_us when the answer reflects the time of the query
-- Example: fsar-ledger query audit/query_candidates LEDGER --param run=RUN --param action=injected-1-2 --param
--   robot=robot/C1
--   answers robot/C1 was rejected by visibility: not visible to role D
-- Parameters: run: run = all, action: action = all, robot: robot = all
WITH considered AS (
    SELECT
        asked.run_id, asked.seq, asked.time_us, asked.caused_by, asked.task_id, asked.action_id, asked.requested_by,
        asked.executed_by, asked.supervised_by, asked.capability, asked.candidates, asked.relay, asked.domain,
        asked.as_of_us, others.robot, gone.robot IS NOT NULL AS is_away, askers.role, runs.configuration, runs.observes,
        list_extract(asked.rejected_by, list_position(asked.rejected, others.robot)) AS rejected_by,
        any_value(surfaces.visible_to) AS visible_to, any_value(surfaces.visibility) AS visibility,
        count(surfaces.robot) > 0 AS is_offered,
        arg_max(trust.scope, trust.precedence) AS trust_scope
    FROM registry_queried AS asked
    INNER JOIN runs ON asked.run_id = runs.run_id
    INNER JOIN fleet_members AS others
        ON asked.run_id = others.run_id AND asked.requested_by <> others.robot AND asked.seq > others.joined_seq
    LEFT JOIN fleet_members AS askers ON asked.run_id = askers.run_id AND asked.requested_by = askers.robot
    LEFT JOIN advertisements AS surfaces
        ON
            asked.run_id = surfaces.run_id AND others.robot = surfaces.robot
            AND (
                asked.capability = surfaces.capability
                OR (asked.capability LIKE '%.*' AND starts_with(surfaces.capability, asked.capability[:-2]))
            )
            AND asked.seq > surfaces.since_seq AND (surfaces.until_seq IS NULL OR asked.seq < surfaces.until_seq)
    LEFT JOIN departed_robots AS gone
        ON
            asked.run_id = gone.run_id AND others.robot = gone.robot
            AND asked.seq BETWEEN gone.since_seq AND coalesce(gone.until_seq, asked.seq)
    LEFT JOIN trust_parties AS own
        ON asked.run_id = own.run_id AND others.robot = own.robot AND own.is_trusting AND asked.seq > own.seq
    LEFT JOIN trust_parties AS peer
        ON own.run_id = peer.run_id AND own.seq = peer.seq AND asked.requested_by = peer.robot AND NOT peer.is_trusting
    LEFT JOIN trust_precedence AS trust
        ON
            peer.run_id = trust.run_id AND peer.seq = trust.seq
            AND (trust.capability IS NULL OR asked.capability = trust.capability)
            AND (trust.context IS NULL OR asked.task_id = trust.context)
    WHERE $run IN ('all', asked.run_id) AND $action IN ('all', asked.action_id) AND $robot IN ('all', others.robot)
    GROUP BY ALL
)

SELECT
    run_id, seq, time_us, caused_by, task_id, action_id, requested_by, executed_by, supervised_by, capability, relay,
    domain, as_of_us, robot, trust_scope,
    list_contains(candidates, robot) AS is_candidate, rejected_by,
    CASE
        WHEN list_contains(candidates, robot)
            THEN concat('candidate', ' through ' || relay, if(is_away, ', although it had departed', NULL))
        WHEN rejected_by = 'version' THEN 'its version is out of range or deprecated'
        WHEN rejected_by = 'contract' THEN 'its contract does not suit'
        WHEN rejected_by = 'policy' THEN 'its declared policy does not allow it'
        WHEN rejected_by = 'authority' THEN 'its authority profile does not allow the override'
        WHEN rejected_by = 'availability' THEN if(is_away, 'it had departed', 'offline or restricted')
        WHEN rejected_by = 'embodiment' THEN 'not the body that is needed'
        WHEN rejected_by IS NULL AND NOT is_offered AND list_contains(observes, 'registry') THEN 'does not offer it'
        WHEN rejected_by IS NULL AND is_away THEN 'it had departed'
        WHEN len(visible_to) > 0 AND NOT coalesce(list_contains(visible_to, role), FALSE)
            THEN 'not visible to role ' || coalesce(role, 'unknown')
        WHEN rejected_by = 'visibility'
            THEN 'not visible outside ' || if(visibility = 'domain', 'its domain', 'its trust')
        WHEN coalesce(trust_scope, 'none') = 'none' AND list_has_all(observes, ['fleet', 'trust'])
            THEN 'no trust in the requester'
        WHEN rejected_by = 'trust' THEN 'too little trust in the requester'
        WHEN regexp_matches(configuration, '^without-(.*[+])?shared-registry([+]|$)') THEN 'not met lately'
        WHEN domain <> '' THEN 'not reached by the search'
        ELSE 'the record gives no reason'
    END AS reason
FROM considered
