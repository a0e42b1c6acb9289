-- Title: The candidates of a query, and why each other robot was none: the filter that left it out, else what its
--   surface and its trust say
-- Paper: sec:architecture:registry, eq:adv, eq:trust
-- Grain: one row per RegistryQueried event and other robot of the fleet
-- Key: run_id, seq, robot
-- Units: time_us, as_of_us microseconds of run time
-- NULL: rejected_by when the record names no filter for the robot; trust_scope when the robot had not set any for the
--   requester; relay when the query was answered without one; as_of_us when it was answered from the present; action_id
--   when the query is tied to no action
-- Example: fsar-ledger query audit/query_candidates LEDGER --param run=RUN --param action=injected-1-2 --param
--   robot=robot/C1
--   answers robot/C1 was rejected by visibility: not visible to role D
-- Parameters: run = all, action = all, robot = all
WITH filters (filter, meaning) AS (
    VALUES
    ('version', 'its version is out of range or deprecated'), ('contract', 'its contract does not suit'),
    ('policy', 'its declared policy does not allow it'),
    ('authority', 'its authority profile does not allow the override'),
    ('availability', 'offline or restricted'), ('embodiment', 'not the body that is needed')
),

surfaces AS (
    SELECT
        run_id, robot, capability,
        seq AS since_seq,
        lead(seq) OVER (PARTITION BY run_id, robot, capability ORDER BY seq) AS until_seq,
        type = 'CapabilityAdvertised.v1' AS is_shown,
        visible_to, visibility
    FROM registry_events
    WHERE type IN ('CapabilityAdvertised.v1', 'CapabilityWithdrawn.v1', 'CapabilityRemoved.v1')
),

considered AS (
    SELECT
        queries.run_id, queries.seq, queries.time_us, queries.caused_by, queries.task_id, queries.action_id,
        queries.requested_by, queries.executed_by, queries.supervised_by, queries.capability, queries.candidates,
        queries.relay, queries.rejected, queries.rejected_by, queries.domain, queries.as_of_us, others.robot,
        requesters.role,
        list_extract(queries.rejected_by, list_position(queries.rejected, others.robot)) AS filter,
        any_value(surfaces.visible_to) AS visible_to,
        any_value(surfaces.visibility) AS visibility,
        count(surfaces.robot) > 0 AS is_offered,
        arg_max(trust.scope, trust.precedence) AS trust_scope
    FROM registry_queried AS queries
    INNER JOIN fleet_members AS others
        ON queries.run_id = others.run_id AND queries.requested_by <> others.robot AND queries.seq > others.joined_seq
    LEFT JOIN fleet_members AS requesters
        ON queries.run_id = requesters.run_id AND queries.requested_by = requesters.robot
    LEFT JOIN surfaces
        ON
            queries.run_id = surfaces.run_id AND others.robot = surfaces.robot AND surfaces.is_shown
            AND (
                queries.capability = surfaces.capability
                OR (queries.capability LIKE '%.*' AND starts_with(surfaces.capability, queries.capability[:-2]))
            )
            AND queries.seq > surfaces.since_seq AND (surfaces.until_seq IS NULL OR queries.seq < surfaces.until_seq)
    LEFT JOIN trust_parties AS trusting
        ON
            queries.run_id = trusting.run_id AND others.robot = trusting.robot AND trusting.is_trusting
            AND queries.seq > trusting.seq
    LEFT JOIN trust_parties AS trusted
        ON
            trusting.run_id = trusted.run_id AND trusting.seq = trusted.seq AND queries.requested_by = trusted.robot
            AND NOT trusted.is_trusting
    LEFT JOIN trust_precedence AS trust
        ON
            trusted.run_id = trust.run_id AND trusted.seq = trust.seq
            AND (trust.capability IS NULL OR queries.capability = trust.capability)
            AND (trust.context IS NULL OR queries.task_id = trust.context)
    WHERE $run IN ('all', queries.run_id) AND $action IN ('all', queries.action_id) AND $robot IN ('all', others.robot)
    GROUP BY ALL
)

SELECT
    considered.run_id, considered.seq, considered.time_us, considered.caused_by, considered.task_id,
    considered.action_id, considered.requested_by, considered.executed_by, considered.supervised_by,
    considered.capability, considered.relay, considered.domain, considered.as_of_us, considered.robot,
    considered.trust_scope,
    list_contains(considered.candidates, considered.robot) AS is_candidate,
    considered.filter AS rejected_by,
    CASE
        WHEN list_contains(considered.candidates, considered.robot)
            THEN 'candidate' || coalesce(' through ' || considered.relay, '')
        WHEN filters.meaning IS NOT NULL THEN filters.meaning
        WHEN considered.filter IS NULL AND NOT considered.is_offered THEN 'does not offer it'
        WHEN
            len(considered.visible_to) > 0
            AND NOT coalesce(list_contains(considered.visible_to, considered.role), FALSE)
            THEN 'not visible to role ' || coalesce(considered.role, 'unknown')
        WHEN considered.filter = 'visibility'
            THEN 'not visible outside ' || if(considered.visibility = 'domain', 'its domain', 'its trust')
        WHEN coalesce(considered.trust_scope, 'none') = 'none' THEN 'no trust in the requester'
        WHEN considered.filter = 'trust' THEN 'too little trust in the requester'
        WHEN regexp_matches(runs.configuration, '^without-(.*[+])?shared-registry([+]|$)') THEN 'not met lately'
        WHEN considered.domain <> '' THEN 'not reached by the search'
        ELSE 'the record gives no reason'
    END AS reason
FROM considered
INNER JOIN runs ON considered.run_id = runs.run_id
LEFT JOIN filters ON considered.filter = filters.filter
