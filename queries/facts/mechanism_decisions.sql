-- Title: Decisions of each mechanism
-- Paper: eq:admissible, eq:adv, eq:override, eq:recovery
-- Grain: one row per event by which a mechanism decided, and per robot that a registry left out
-- Key: none, a start that is held has an event each time it is looked at
-- Units: about: the position of the query and the robot left out; the action whose start was held; else the position of
--   the event
-- NULL: about of a held start, and mechanism of a robot left out, where the record names no action, or no filter
-- Example: fsar-ledger query facts/mechanism_decisions LEDGER
WITH said AS (
    SELECT
        run_id,
        if(type = 'ExecutionHeld.v1', action_id, seq::VARCHAR) AS about,
        CASE type
            WHEN 'RequestDenied.v1'
                THEN 'denied: ' || if(reason IN ('bid', 'own step'), 'policy', if(reason = 'no trust', 'trust', reason))
            WHEN 'RequestDeferred.v1' THEN 'deferred'
            WHEN 'RequestCountered.v1' THEN 'counter-offer'
            WHEN 'RequestRelayed.v1' THEN 'passed on by a relay'
            WHEN 'RequestAdmitted.v1' THEN if(override <> 'none', 'override level in effect', NULL)
            WHEN 'ExecutionHeld.v1' THEN 'start held: ' || reason
            WHEN 'RoutineWithheld.v1' THEN 'motion withheld'
            WHEN 'PolicyConflictEscalated.v1' THEN 'conflict escalated'
            WHEN 'SupervisorCalled.v1' THEN 'asked: ' || purpose
            WHEN 'TrustSet.v1' THEN if(reason = 'record', 'moved by record', NULL)
            WHEN 'AttemptRolledBack.v1' THEN 'attempt rolled back'
            WHEN 'RecoveryAttemptFailed.v1' THEN if(result = 'partial', 'partial result', NULL)
            WHEN 'ExecutionFinished.v1' THEN if(result = 'partial', 'partial result', NULL)
            WHEN 'AssistanceAdmitted.v1' THEN 'peer helps'
            WHEN 'ReassignmentDecided.v1' THEN if(helper IS NOT NULL, 'step reassigned', NULL)
            WHEN 'SegmentTransferred.v1' THEN 'segment transferred'
            WHEN 'TaskAbandoned.v1' THEN 'given up'
        END AS mechanism
    FROM events
)

SELECT run_id, about, mechanism
FROM said
WHERE mechanism IS NOT NULL
UNION ALL
SELECT
    run_id,
    seq || ' ' || unnest(rejected) AS about,
    'left out: ' || unnest(rejected_by) AS mechanism
FROM registry_queried
