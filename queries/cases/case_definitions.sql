-- Title: The claims of the paper's four cases: the scenario of each, what is counted, and of how many
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim
-- Key: claim
-- Units: position counts from 1
-- NULL: never; is_taken is whether the claim has the reading that we use; the others are alternatives (R46)
-- Example: fsar-ledger query cases/case_definitions LEDGER
WITH cases (case_number, scenario, judge) AS (
    VALUES
    (1, 'mixed-trust-inspection', 'case_1_trust_boundary'),
    (2, 'failure-recovery-chain', 'case_2_recovery_containment'),
    (3, 'fleet-contention', 'case_3_contention'),
    (4, 'collaborative-delivery', 'case_4_audit_trail')
),

claims (position, case_number, claim, is_taken, counted, of_how_many) AS (
    VALUES
    (1, 1, 'discovered', TRUE, 'requests without trust that discover the capability', 'requests without trust'),
    (2, 1, 'attempted', FALSE, 'requests without trust that are put to a robot', 'requests without trust'),
    (3, 1, 'executed', TRUE, 'requests without trust that are executed', 'requests without trust'),
    (4, 2, 'contained locally', TRUE, 'runs in which the robot itself contains every failure', 'runs with a failure'),
    (
        5, 2, 'escalated at once', TRUE, 'runs in which the coordinator, not the robot, takes up every failure',
        'runs with a failure'
    ),
    (
        6, 2, 'recovery loop', TRUE, 'runs in which agents of a robot dispute who recovers, and then escalate',
        'runs with a failure'
    ),
    (
        7, 2, 'contained locally (degradation)', FALSE,
        'runs in which D itself contains every failure of its worn actuator', 'runs with such a failure'
    ),
    (
        8, 2, 'escalated at once (degradation)', FALSE,
        'runs in which the coordinator, not D, takes up every such failure', 'runs with such a failure'
    ),
    (
        9, 2, 'recovery loop (degradation)', FALSE,
        'runs in which agents of D dispute who recovers from one, and then escalate', 'runs with such a failure'
    ),
    (10, 3, 'conflicts', TRUE, 'conflicts over door.open.secure', 'runs in which two tasks need it at once'),
    (
        11, 3, 'conflicts over execution', FALSE, 'conflicts over who executes door.open.secure',
        'runs in which two tasks need it at once'
    ),
    (
        12, 3, 'conflict for H_F', TRUE, 'runs with such a conflict over execution, and H_F called to order the two',
        'runs in which two tasks need it at once'
    ),
    (13, 4, 'events', TRUE, 'coordination events from the gap to the result', 'handoffs from A to D'),
    (14, 4, 'unattributed events', TRUE, 'those that lack origin, executor or supervisor', 'handoffs from A to D'),
    (15, 4, 'internal events', TRUE, 'unattributed messages between agents of D', 'handoffs from A to D'),
    (
        16, 4, 'internal events (inward)', FALSE, 'those on the way from communication over planning to execution',
        'handoffs from A to D'
    )
)

SELECT
    claims.position, claims.case_number, claims.claim, claims.is_taken, claims.counted, claims.of_how_many,
    cases.scenario, cases.judge
FROM claims
INNER JOIN cases ON claims.case_number = cases.case_number
