-- Title: The authority chain of an action: who asked, relayed, admitted, accepted, supervised, acted and closed
-- Paper: eq:auth, sec:model:request
-- Grain: one row per event of the action in which somebody asks, decides or acts
-- Units: time_us microseconds of run time
-- NULL: a principal that the record does not name; recovery is also found where only its failed action ties it to the action
-- Example: fsar-ledger query audit/authority_chain LEDGER --param run=RUN --param action=B1-1/2.1
--   answers asked robot/B1, admitted robot/C1, accepted robot/C1, acted robot/C1, finished robot/C1, closed service/coordination
-- Parameters: run = all, action = all
WITH deeds (type, deed) AS (
    VALUES
    ('RequestIssued.v1', 'asked'),
    ('OwnStepDecided.v1', 'decided'),
    ('RequestRelayed.v1', 'relayed'),
    ('RequestAdmitted.v1', 'admitted'),
    ('RequestDenied.v1', 'denied'),
    ('RequestDeferred.v1', 'deferred'),
    ('CommandIssued.v1', 'commanded'),
    ('RequestAccepted.v1', 'accepted'),
    ('SupervisorResponded.v1', 'supervised'),
    ('ExecutionStarted.v1', 'acted'),
    ('ExecutionFinished.v1', 'finished'),
    ('RecoveryAttempted.v1', 'recovered'),
    ('RecoveryEscalated.v1', 'escalated'),
    ('AssistanceRequested.v1', 'asked for help'),
    ('AssistanceAdmitted.v1', 'agreed to help'),
    ('ReassignmentDecided.v1', 'reassigned'),
    ('RequestClosed.v1', 'closed')
)

SELECT
    events.run_id,
    coalesce(events.action_id, events.failed_action) AS action_id,
    events.seq,
    events.time_us,
    deeds.deed,
    CASE WHEN deeds.deed IN ('acted', 'finished') THEN events.executed_by ELSE events.decided_by END AS principal,
    events.requested_by,
    events.executed_by,
    events.supervised_by,
    events.path
FROM events
INNER JOIN deeds ON events.type = deeds.type
WHERE
    $run IN ('all', events.run_id)
    AND coalesce(events.action_id, events.failed_action) IS NOT NULL
    AND $action IN ('all', coalesce(events.action_id, events.failed_action))
