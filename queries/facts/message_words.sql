-- Title: The wording of each event type in the timeline of a request: who tells whom what
-- Paper: sec:model:request, fig:wf1
-- Grain: one row per event type and part; a registry's answer has two parts, the question and the answer
-- Key: type, part
-- Units: part counts from 1
-- NULL: detail when the words are complete; otherwise the field whose value follows them
-- Example: fsar-ledger query facts/message_words LEDGER
WITH words (type, part, sender, receiver, words, detail) AS (
    VALUES
    ('OutsiderRequestInjected.v1', 1, 'robot', 'peer', 'attempts without trust', 'capability'),
    ('GapDetected.v1', 1, 'requester', 'requester', 'lacks', 'capability'),
    ('RegistryQueried.v1', 1, 'requester', 'registry', 'query', 'capability'),
    ('RegistryQueried.v1', 2, 'registry', 'requester', 'candidates', 'candidates'),
    ('RequestIssued.v1', 1, 'decider', 'target', 'request', 'capability'),
    ('RequestRelayed.v1', 1, 'decider', 'executor', 'passes the request on', NULL),
    ('RequestUnanswered.v1', 1, 'decider', 'decider', 'asks in vain for', 'capability'),
    ('PeerSought.v1', 1, 'robot', 'robot', 'looks again among the peers it met', NULL),
    ('CandidateMatched.v1', 1, 'decider', 'decider', 'considers a candidate', 'capability'),
    ('BidSubmitted.v1', 1, 'robot', 'requester', 'bid', 'outcome'),
    ('AwardMade.v1', 1, 'requester', 'robot', 'award', NULL),
    ('MessageUndelivered.v1', 1, 'robot', 'robot', 'cannot be reached', NULL),
    ('InternalHandoff.v1', 1, 'sender', 'receiver', 'hands over', NULL),
    ('RequestAdmitted.v1', 1, 'decider', 'decider', 'evaluate', 'policy'),
    ('RequestDenied.v1', 1, 'decider', 'requester', 'deny', 'reason'),
    ('RequestDeferred.v1', 1, 'decider', 'requester', 'defer', NULL),
    ('RequestCountered.v1', 1, 'decider', 'requester', 'counter-offer', 'override'),
    ('OfferAnswered.v1', 1, 'decider', 'executor', 'answers the offer', 'answer'),
    ('CommandIssued.v1', 1, 'decider', 'robot', 'command', NULL),
    ('RequestAccepted.v1', 1, 'decider', 'requester', 'accept', NULL),
    ('ContractQuestioned.v1', 1, 'robot', 'robot', 'contract in doubt', NULL),
    ('ContractVoided.v1', 1, 'robot', 'robot', 'contract void', NULL),
    ('OwnStepDecided.v1', 1, 'decider', 'doer', 'own step', 'capability'),
    ('ApproachStarted.v1', 1, 'robot', 'robot', 'approaches', NULL),
    ('ExecutionHeld.v1', 1, 'robot', 'robot', 'waits, policy says', 'outcome'),
    ('ExecutionStarted.v1', 1, 'robot', 'robot', 'executes', 'capability'),
    ('ExecutionPaused.v1', 1, 'robot', 'robot', 'pauses', NULL),
    ('ExecutionHalted.v1', 1, 'robot', 'robot', 'is off', NULL),
    ('ExecutionPreempted.v1', 1, 'robot', 'robot', 'gives way', NULL),
    ('ReplanOrdered.v1', 1, 'decider', 'executor', 'new plan', NULL),
    ('ExecutionResumed.v1', 1, 'robot', 'robot', 'goes on', NULL),
    ('ExecutionFailed.v1', 1, 'robot', 'robot', 'fails', 'cause'),
    ('ExecutionWithdrawn.v1', 1, 'robot', 'robot', 'is released from it', NULL),
    ('ExecutionFinished.v1', 1, 'robot', 'requester', 'result', 'result'),
    ('RequestClosed.v1', 1, 'decider', 'requester', 'close', 'result'),
    ('AuthorityClaimed.v1', 1, 'claimant', 'claimant', 'revokes', NULL),
    ('PolicyConflictEscalated.v1', 1, 'decider', 'supervisor', 'policy conflict', NULL),
    ('SupervisorCalled.v1', 1, 'caller', 'called', 'asks to decide', 'purpose'),
    ('SupervisorResponded.v1', 1, 'decider', 'asker', 'decides', 'decision'),
    ('RecoveryAttempted.v1', 1, 'decider', 'robot', 'recovery attempt', 'number'),
    ('RecoveryAttemptFailed.v1', 1, 'robot', 'robot', 'attempt ends', 'result'),
    ('AttemptRolledBack.v1', 1, 'robot', 'robot', 'undoes what the attempt achieved', NULL),
    ('RecoveryEscalated.v1', 1, 'decider', 'decider', 'recovery goes on', 'levels'),
    ('AssistanceRequested.v1', 1, 'decider', 'helper', 'asks for help', NULL),
    ('AssistanceAdmitted.v1', 1, 'helper', 'robot', 'agrees to help', NULL),
    ('AssistanceDeclined.v1', 1, 'helper', 'robot', 'declines', NULL),
    ('AssistanceEnded.v1', 1, 'helper', 'robot', 'has helped', NULL),
    ('AssistanceFailed.v1', 1, 'helper', 'robot', 'could not help', 'cause'),
    ('ReassignmentDecided.v1', 1, 'decider', 'helper', 'reassigns', 'checkpoint'),
    ('TaskStateTransferred.v1', 1, 'robot', 'helper', 'state of the task', 'checkpoint'),
    ('FailureResolved.v1', 1, 'robot', 'robot', 'failure resolved', 'level')
)

SELECT *
FROM words
