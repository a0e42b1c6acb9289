-- Title: The claims of the paper's four cases: in which scenario each is made, and what is counted of how many
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim
-- Units: none
-- NULL: never; is_taken is whether it is the reading of the claim that is taken; the others show what else it could mean (R46)
-- Example: fsar-ledger query cases/case_definitions LEDGER
WITH claims (case_number, scenario, judge, claim, is_taken, counted, of_how_many) AS (
    VALUES
    (1, 'mixed-trust-inspection', 'case_1_trust_boundary', 'discovered', TRUE, 'requests without trust that discover the capability', 'requests without trust'),
    (1, 'mixed-trust-inspection', 'case_1_trust_boundary', 'attempted', FALSE, 'requests without trust that are put to a robot', 'requests without trust'),
    (1, 'mixed-trust-inspection', 'case_1_trust_boundary', 'executed', TRUE, 'requests without trust that are executed', 'requests without trust'),
    (
        2, 'failure-recovery-chain', 'case_2_recovery_containment', 'contained locally', TRUE,
        'runs in which every failure is contained by the robot''s own recovery', 'runs with a failure'
    ),
    (
        2, 'failure-recovery-chain', 'case_2_recovery_containment', 'escalated at once', TRUE,
        'runs in which every failure goes to the coordinator before anything else is done about it', 'runs with a failure'
    ),
    (
        2, 'failure-recovery-chain', 'case_2_recovery_containment', 'recovery loop', TRUE,
        'runs in which agents of one robot dispute who recovers, and escalate then', 'runs with a failure'
    ),
    (
        2, 'failure-recovery-chain', 'case_2_recovery_containment', 'contained locally (degradation)', FALSE,
        'runs in which every failure of D''s worn actuator is contained by its own recovery', 'runs with such a failure'
    ),
    (
        2, 'failure-recovery-chain', 'case_2_recovery_containment', 'escalated at once (degradation)', FALSE,
        'runs in which every such failure goes to the coordinator before anything else is done about it', 'runs with such a failure'
    ),
    (
        2, 'failure-recovery-chain', 'case_2_recovery_containment', 'recovery loop (degradation)', FALSE,
        'runs in which agents of D dispute who recovers from one, and escalate then', 'runs with such a failure'
    ),
    (3, 'fleet-contention', 'case_3_contention', 'conflicts', TRUE, 'conflicts over door.open.secure', 'runs in which two tasks want it at once'),
    (3, 'fleet-contention', 'case_3_contention', 'conflicts over execution', FALSE, 'those over who executes', 'runs in which two tasks want it at once'),
    (
        3, 'fleet-contention', 'case_3_contention', 'conflict for H_F', TRUE,
        'runs with a conflict over door.open.secure and a call to H_F to order two requests for it', 'runs in which two tasks want it at once'
    ),
    (4, 'collaborative-delivery', 'case_4_audit_trail', 'events', TRUE, 'coordination events from the gap to the result', 'handoffs from A to D'),
    (4, 'collaborative-delivery', 'case_4_audit_trail', 'unattributed events', TRUE, 'those without origin, executor or supervisor', 'handoffs from A to D'),
    (4, 'collaborative-delivery', 'case_4_audit_trail', 'internal events', TRUE, 'unattributed messages between agents of D', 'handoffs from A to D'),
    (
        4, 'collaborative-delivery', 'case_4_audit_trail', 'internal events (inward)', FALSE,
        'those from communication to planning and from planning to execution', 'handoffs from A to D'
    )
)

SELECT *
FROM claims
