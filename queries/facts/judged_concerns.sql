-- Title: The concerns that each judgement rests on: metrics, invariants, parts of features, mechanisms, cases
-- Paper: sec:evaluation:metrics
-- Grain: one row per judge and concern
-- Key: judge, concern
-- Units: none
-- NULL: never; is_context is whether nothing can be judged without the concern. Without any other concern an offence
--   that is found stands, but nothing can be shown to hold
-- Example: fsar-ledger query facts/judged_concerns LEDGER
WITH judges (judges, context, looked_at) AS (
    VALUES
    (
        ['i1_local_agent_coherence'], 'fleet',
        'registry trust policy request authority execution recovery supervision message'
    ),
    (['i2_local_execution_ownership'], 'request', 'execution authority'),
    (['coordination_cost'], 'registry task request execution recovery supervision message', ''),
    (['i3_jointly_composed_policy'], 'request supervision', 'fleet policy execution knowledge'),
    (['i4_outward_recovery'], 'recovery supervision', 'fleet'),
    (
        ['i5_audit_attributability', 'records with origin, executor and supervisor'],
        'fleet registry request policy execution recovery supervision message',
        ''
    ),
    (['a1_local_runtime_self_sufficiency'], 'execution', ''),
    (
        ['a2_coordination_only_federation'], '',
        'fleet registry trust policy task request authority execution recovery supervision knowledge message world'
    ),
    (['a3_no_silent_policy_override'], 'request policy execution supervision knowledge', 'fleet'),
    (['a4_thin_federation_interface'], '', 'request execution recovery'),
    (['a5_audit_completeness'], 'fleet request recovery supervision', 'task execution'),
    (
        ['robots that appear as one principal', 'robots with two or more agents'],
        'fleet registry trust policy request authority execution recovery supervision message',
        ''
    ),
    (['assignments decided by one principal that is no robot'], 'request recovery', ''),
    (['untrusted delegations that went through trusted links'], 'fleet trust request execution', ''),
    (['outsiders refused', 'hidden capabilities kept from outsiders'], 'execution world', ''),
    (['failures that the robot itself begins to recover'], 'recovery registry supervision', ''),
    (['failures that skip no level', 'levels of recovery in use'], 'recovery', ''),
    (['decisions on the executor''s policy'], 'request knowledge', ''),
    (['the requester''s policy heeded', 'the fleet''s rule heeded'], 'fleet policy task request supervision', ''),
    (['delegations found beyond the peers that were met'], 'registry request execution knowledge', ''),
    (['inter_robot_request'], 'request recovery', ''),
    (['trust_evaluation', 'authority_tuple', 'delegation_chain'], 'request', ''),
    (['policy_composition'], 'request supervision', ''),
    (['registry_discovery'], 'registry supervision', ''),
    (['layered_recovery', 'fleet_reassignment'], 'recovery', ''),
    (['human_escalation'], 'recovery supervision', ''),
    (['case_1_trust_boundary'], 'registry request execution world', ''),
    (['case_2_recovery_containment'], 'fleet registry authority recovery supervision', ''),
    (['case_3_contention'], 'task authority supervision', ''),
    (
        ['case_4_audit_trail'],
        'fleet registry policy task request authority execution recovery supervision knowledge message',
        ''
    )
),

named AS (
    SELECT unnest(judges) AS judge, string_split(context, ' ') AS context, string_split(looked_at, ' ') AS looked_at
    FROM judges
),

needed AS (
    SELECT judge, unnest(context || looked_at) AS concern, list_contains(context, concern) AS is_context
    FROM named
)

SELECT judge, concern, is_context
FROM needed
WHERE concern <> ''
UNION ALL
SELECT judge, concern, TRUE AS is_context
FROM metric_concerns
