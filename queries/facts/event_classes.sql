-- Title: The class of each event type: decision, audit record or both, and whose part in the action it records
-- Paper: sec:evaluation:metrics
-- Grain: one row per event type that is a decision or a coordination event
-- Key: type
-- Units: none
-- NULL: decision_kind when the type is no decision; record_kind when it is no coordination event
-- Example: fsar-ledger query facts/event_classes LEDGER
WITH classes (type, decision_kind, record_kind, requires_origin, requires_executor, requires_supervisor, part) AS (
    VALUES
    ('GapDetected.v1', NULL, 'gap', TRUE, TRUE, TRUE, 'requester'),
    ('RegistryQueried.v1', NULL, 'query', TRUE, TRUE, TRUE, 'requester'),
    ('RequestIssued.v1', 'request', 'request', TRUE, TRUE, TRUE, 'requester'),
    ('RequestUnanswered.v1', 'request', 'request', TRUE, TRUE, TRUE, 'requester'),
    ('CandidateMatched.v1', 'admission', 'matching', TRUE, TRUE, TRUE, 'executor'),
    ('RequestAdmitted.v1', 'admission', 'admissibility', TRUE, TRUE, TRUE, 'executor'),
    ('CommandIssued.v1', 'delegation', 'delegation', TRUE, TRUE, TRUE, 'executor'),
    ('SegmentTransferred.v1', 'delegation', 'delegation', TRUE, TRUE, TRUE, 'requester'),
    ('RequestAccepted.v1', 'commit', 'acceptance', TRUE, TRUE, TRUE, 'executor'),
    ('ExecutionStarted.v1', NULL, 'execution', TRUE, TRUE, TRUE, 'executor'),
    ('ExecutionFinished.v1', NULL, 'result', TRUE, TRUE, TRUE, 'executor'),
    ('OwnStepDecided.v1', 'own-step', 'request', TRUE, TRUE, TRUE, 'executor'),
    ('BidSubmitted.v1', NULL, 'bid', TRUE, TRUE, TRUE, 'executor'),
    ('AwardMade.v1', NULL, 'award', TRUE, TRUE, TRUE, 'requester'),
    ('InternalHandoff.v1', NULL, 'handoff', TRUE, TRUE, TRUE, 'executor'),
    ('ReplanOrdered.v1', 'replan', 'replan', TRUE, TRUE, TRUE, 'executor'),
    ('RecoveryAttempted.v1', 'recovery', 'recovery', TRUE, TRUE, TRUE, 'executor'),
    ('RecoveryEscalated.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE, 'executor'),
    ('AssistanceRequested.v1', 'request', 'request', TRUE, TRUE, TRUE, 'executor'),
    ('ReassignmentDecided.v1', 'delegation', 'reassignment', TRUE, TRUE, TRUE, 'executor'),
    ('PolicyConflictEscalated.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE, 'executor'),
    ('SupervisorResponded.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE, 'executor'),
    ('RequestCountered.v1', 'negotiation', 'negotiation', TRUE, TRUE, TRUE, 'executor'),
    ('OfferAnswered.v1', 'negotiation', 'negotiation', TRUE, TRUE, TRUE, 'requester'),
    ('RoutinePerformed.v1', 'routine', 'routine', TRUE, TRUE, TRUE, 'executor'),
    ('RoutineWithheld.v1', 'routine', 'routine', TRUE, TRUE, TRUE, 'executor'),
    ('RoutineReported.v1', NULL, 'routine', TRUE, TRUE, TRUE, 'executor'),
    ('RequestRelayed.v1', 'delegation', NULL, FALSE, FALSE, FALSE, 'executor'),
    ('RequestDenied.v1', 'denial', NULL, FALSE, FALSE, FALSE, 'executor'),
    ('RequestDeferred.v1', 'defer', NULL, FALSE, FALSE, FALSE, 'executor'),
    ('RequestClosed.v1', 'closing', NULL, FALSE, FALSE, FALSE, 'requester'),
    ('ExecutionHeld.v1', 'denial', NULL, FALSE, FALSE, FALSE, 'executor'),
    ('AssistanceAdmitted.v1', 'admission', NULL, FALSE, FALSE, FALSE, 'executor')
)

SELECT *
FROM classes
