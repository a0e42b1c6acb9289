-- Title: A5 broken: an execution for another robot is not fully on record
-- Paper: sec:architecture:invariants (A5), eq:request
-- Grain: one row per start or end of an execution for another robot whose own record lacks or misstates a principal, and per such start without an
--        earlier request (or reassignment) and acceptance of its action
-- Units: time_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query invariants/a5_audit_completeness LEDGER
-- The robots are physical facts, the principals what was recorded. No supervisor is needed while that of the executing robot is recorded as absent;
-- a robot without one of its own is supervised by H_F, who is always there.
WITH executions AS (
    SELECT
        starts.run_id,
        starts.action_id,
        starts.robot,
        arg_min(starts.on_behalf_of, starts.seq) AS on_behalf_of
    FROM execution_started AS starts
    WHERE starts.robot <> starts.on_behalf_of
    GROUP BY starts.run_id, starts.action_id, starts.robot
),

records AS (
    SELECT
        events.run_id,
        events.seq,
        events.time_us,
        events.type,
        events.action_id,
        events.requested_by,
        events.executed_by,
        events.supervised_by,
        executions.robot,
        executions.on_behalf_of
    FROM executions
    INNER JOIN events ON executions.run_id = events.run_id AND executions.action_id = events.action_id AND executions.robot = events.robot
    WHERE events.type IN ('ExecutionStarted.v1', 'ExecutionFinished.v1')
),

phases AS (
    SELECT
        records.run_id,
        records.seq,
        count_if(events.type = 'RequestIssued.v1' OR (events.type = 'ReassignmentDecided.v1' AND events.helper = records.robot)) AS requests,
        count_if(events.type = 'RequestAccepted.v1') AS acceptances
    FROM records
    INNER JOIN events ON records.run_id = events.run_id AND records.action_id = events.action_id AND records.seq > events.seq
    GROUP BY records.run_id, records.seq
),

judged AS (
    SELECT
        records.*,
        concat_ws(
            ', ',
            CASE WHEN records.requested_by IS DISTINCT FROM records.on_behalf_of THEN 'requester ' || coalesce(records.requested_by, 'missing') END,
            CASE WHEN records.executed_by IS DISTINCT FROM records.robot THEN 'executor ' || coalesce(records.executed_by, 'missing') END,
            CASE WHEN records.supervised_by IS NULL AND absences.supervisor IS NULL THEN 'supervisor missing' END,
            CASE WHEN coalesce(phases.requests, 0) = 0 THEN 'no earlier request' END,
            CASE WHEN coalesce(phases.acceptances, 0) = 0 THEN 'no earlier acceptance' END
        ) AS lacks
    FROM records
    LEFT JOIN phases ON records.run_id = phases.run_id AND records.seq = phases.seq
    LEFT JOIN robot_joined AS members ON records.run_id = members.run_id AND records.robot = members.robot
    LEFT JOIN supervisor_absences AS absences
        ON
            records.run_id = absences.run_id AND members.supervisor = absences.supervisor
            AND records.seq > absences.left_seq AND records.seq < coalesce(absences.returned_seq, records.seq + 1)
)

SELECT
    run_id,
    seq,
    time_us,
    type,
    action_id,
    robot || ' for ' || on_behalf_of || ': ' || lacks AS found
FROM judged
WHERE lacks <> ''
