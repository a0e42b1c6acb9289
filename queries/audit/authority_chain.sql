-- Title: The authority chain of an action: who granted, asked, relayed, admitted, accepted, supervised, acted and
--   closed
-- Paper: eq:auth, sec:model:request
-- Grain: one row per event of the action in which a principal asks, decides or acts, and per grant or revocation that
--   bears on its request
-- Key: run_id, action_id, seq
-- Units: time_us microseconds of run time
-- NULL: a principal that the record does not name; the authority tuple and trust where it gives none; also included are
--   recovery tied to the action only as its failed action, a denial tied to it only by its cause, and an own step tied
--   to it only by its effect; an answer that orders two actions has the parties of the action for which the supervisor
--   was called
-- Example: fsar-ledger query audit/authority_chain LEDGER --param run=RUN --param action=B1-1/2.1
--   answers asked robot/B1, admitted robot/C1 (session; may ask, may execute, none, audited), accepted, acted,
--   finished, closed service/coordination
-- Parameters: run: run = all, action: action = all
WITH deeds (type, deed) AS (
    VALUES
    ('RequestIssued.v1', 'asked'),
    ('OwnStepDecided.v1', 'decided'),
    ('RequestRelayed.v1', 'relayed'),
    ('RequestAdmitted.v1', 'admitted'),
    ('RequestDenied.v1', 'denied'),
    ('RequestDeferred.v1', 'deferred'),
    ('RequestCountered.v1', 'countered'),
    ('OfferAnswered.v1', 'answered'),
    ('CommandIssued.v1', 'commanded'),
    ('RequestAccepted.v1', 'accepted'),
    ('SupervisorResponded.v1', 'supervised'),
    ('ExecutionPreempted.v1', 'interrupted'),
    ('ExecutionStarted.v1', 'acted'), ('ExecutionFinished.v1', 'finished'),
    ('RecoveryAttempted.v1', 'recovered'), ('RecoveryEscalated.v1', 'escalated'),
    ('AssistanceRequested.v1', 'asked for help'), ('AssistanceAdmitted.v1', 'agreed to help'),
    ('ReassignmentDecided.v1', 'reassigned'),
    ('RequestClosed.v1', 'closed'),
    ('AuthorityGranted.v1', 'granted'), ('AuthorityRevoked.v1', 'revoked')
),

tuples AS (
    SELECT run_id, seq, trust, may_request, may_execute, override, is_audited
    FROM request_events
    UNION ALL BY NAME
    SELECT run_id, seq, override
    FROM authority_granted
),

concerned AS (
    -- Rights that bear on an evaluation, and events of the action itself; an event that is both appears once.
    SELECT rights.run_id, rights.seq, evaluations.action_id
    FROM authority_events AS rights
    INNER JOIN evaluations
        ON
            rights.run_id = evaluations.run_id AND rights.seq < evaluations.seq
            AND rights.requested_by IN (evaluations.requested_by, evaluations.relay)
            AND coalesce(rights.executed_by = evaluations.executed_by, rights.executed_by IS NULL)
            AND coalesce(rights.capability = evaluations.capability, rights.capability IS NULL)
            AND coalesce(rights.context = evaluations.context, rights.context IS NULL)
    WHERE rights.type IN ('AuthorityGranted.v1', 'AuthorityRevoked.v1')
    UNION
    SELECT run_id, seq, action_id FROM action_events
)

SELECT
    events.run_id, concerned.action_id, events.seq, events.time_us, deeds.deed,
    CASE WHEN deeds.deed IN ('acted', 'finished') THEN events.executed_by ELSE events.decided_by END AS principal,
    events.requested_by, events.executed_by, events.supervised_by, events.path, tuples.trust, tuples.may_request,
    tuples.may_execute, tuples.override, tuples.is_audited
FROM concerned
INNER JOIN event_principals AS events ON concerned.run_id = events.run_id AND concerned.seq = events.seq
INNER JOIN deeds ON events.type = deeds.type
LEFT JOIN tuples ON events.run_id = tuples.run_id AND events.seq = tuples.seq
WHERE
    concerned.action_id IS NOT NULL
    AND $run IN ('all', events.run_id) AND $action IN ('all', concerned.action_id)
