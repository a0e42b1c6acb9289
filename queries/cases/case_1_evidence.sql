-- Title: Case 1, request by request: which untrusted requests discovered a capability not visible to them, were sent to
--   a robot, were executed
-- Paper: sec:evaluation:qualitative (case 1)
-- Grain: one row per claim and injected request of the scenario whose outcome is on record
-- Key: run_id, claim, seq
-- Units: counted 1 or 0; seq the injection, evidence the event that makes it count, positions in the run
-- NULL: never; evidence is empty where it does not count
-- Example: fsar-ledger query cases/case_1_evidence LEDGER
-- A requester that sends a request has found a recipient, whatever it asked of the registry.
WITH injected AS (
    SELECT outsiders.run_id, outsiders.seq, outsiders.task_id AS action_id
    FROM outsider_request_injected AS outsiders
    INNER JOIN runs ON outsiders.run_id = runs.run_id
    WHERE runs.scenario = 'mixed-trust-inspection'
),

followed AS (
    SELECT
        injected.run_id, injected.seq,
        min(events.seq) FILTER (
            events.type IN ('RequestIssued.v1', 'RequestAdmitted.v1', 'CommandIssued.v1', 'ExecutionStarted.v1')
            OR len(queries.candidates) > 0
        ) AS discovered_seq,
        min(events.seq) FILTER (
            events.type IN ('RequestIssued.v1', 'RequestAdmitted.v1', 'CommandIssued.v1', 'ExecutionStarted.v1')
        ) AS attempted_seq,
        min(events.seq) FILTER (events.type = 'ExecutionStarted.v1') AS executed_seq
    FROM injected
    INNER JOIN keyed_events AS events ON injected.run_id = events.run_id AND injected.action_id = events.action_id
    LEFT JOIN registry_queried AS queries ON events.run_id = queries.run_id AND events.seq = queries.seq
    WHERE
        events.type IN (
            'RegistryQueried.v1',
            'RequestIssued.v1',
            'RequestUnanswered.v1',
            'RequestAdmitted.v1',
            'RequestDenied.v1',
            'CommandIssued.v1',
            'ExecutionStarted.v1'
        )
    GROUP BY injected.run_id, injected.seq, injected.action_id
),

judged AS (
    SELECT
        run_id, seq,
        unnest(['discovered', 'attempted', 'executed']) AS claim,
        unnest([discovered_seq, attempted_seq, executed_seq]) AS evidence_seq
    FROM followed
)

SELECT
    run_id, claim, seq,
    (evidence_seq IS NOT NULL)::BIGINT AS counted,
    list_filter([evidence_seq], LAMBDA one: one IS NOT NULL) AS evidence
FROM judged
