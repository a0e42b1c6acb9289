-- Title: What each event type is to a judge: a decision, an audit record, both
-- Paper: sec:evaluation:metrics
-- Grain: one row per event type that is a decision or a coordination event
-- Units: none
-- NULL: decision_kind when the type is no decision; record_kind when it is no coordination event
-- Example: fsar-ledger query facts/event_classes LEDGER
WITH classes (type, decision_kind, record_kind, requires_origin, requires_executor, requires_supervisor) AS (
    VALUES
    ('GapDetected.v1', NULL, 'gap', TRUE, TRUE, TRUE),
    ('RegistryQueried.v1', NULL, 'query', TRUE, TRUE, TRUE),
    ('RequestIssued.v1', 'request', 'request', TRUE, TRUE, TRUE),
    ('RequestUnanswered.v1', 'request', 'request', TRUE, TRUE, TRUE),
    ('CandidateMatched.v1', 'admission', 'matching', TRUE, TRUE, TRUE),
    ('RequestAdmitted.v1', 'admission', 'admissibility', TRUE, TRUE, TRUE),
    ('CommandIssued.v1', 'delegation', 'delegation', TRUE, TRUE, TRUE),
    ('RequestAccepted.v1', 'commit', 'acceptance', TRUE, TRUE, TRUE),
    ('ExecutionStarted.v1', NULL, 'execution', TRUE, TRUE, TRUE),
    ('ExecutionFinished.v1', NULL, 'result', TRUE, TRUE, TRUE),
    ('OwnStepDecided.v1', 'own-step', 'request', TRUE, TRUE, TRUE),
    ('BidSubmitted.v1', NULL, 'bid', TRUE, TRUE, TRUE),
    ('AwardMade.v1', NULL, 'award', TRUE, TRUE, TRUE),
    ('InternalHandoff.v1', NULL, 'handoff', TRUE, TRUE, TRUE),
    ('ReplanOrdered.v1', 'replan', 'replan', TRUE, TRUE, TRUE),
    ('RecoveryAttempted.v1', 'recovery', 'recovery', TRUE, TRUE, TRUE),
    ('RecoveryEscalated.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE),
    ('AssistanceRequested.v1', 'request', 'request', TRUE, TRUE, TRUE),
    ('ReassignmentDecided.v1', 'delegation', 'reassignment', TRUE, TRUE, TRUE),
    ('PolicyConflictEscalated.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE),
    ('SupervisorResponded.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE),
    ('RequestCountered.v1', 'negotiation', 'negotiation', TRUE, TRUE, TRUE),
    ('OfferAnswered.v1', 'negotiation', 'negotiation', TRUE, TRUE, TRUE),
    ('PolicyConflictEscalated.v1', 'escalation', 'escalation', TRUE, TRUE, TRUE),
    ('RoutinePerformed.v1', 'routine', 'routine', TRUE, TRUE, TRUE),
    ('RoutineWithheld.v1', 'routine', 'routine', TRUE, TRUE, TRUE),
    ('RoutineReported.v1', NULL, 'routine', TRUE, TRUE, TRUE),
    ('RequestRelayed.v1', 'delegation', NULL, FALSE, FALSE, FALSE),
    ('RequestDenied.v1', 'denial', NULL, FALSE, FALSE, FALSE),
    ('RequestDeferred.v1', 'defer', NULL, FALSE, FALSE, FALSE),
    ('RequestClosed.v1', 'closing', NULL, FALSE, FALSE, FALSE),
    ('ExecutionHeld.v1', 'denial', NULL, FALSE, FALSE, FALSE),
    ('AssistanceAdmitted.v1', 'admission', NULL, FALSE, FALSE, FALSE)
)

SELECT *
FROM classes
