-- Title: A5 broken: an execution for another robot is not fully recorded
-- Paper: sec:architecture:invariants (A5), eq:request
-- Grain: one row per start or end of an execution for another robot whose own record lacks or misstates a principal,
--   without an earlier request, admission (or reassignment) and acceptance of its action in this order, that another
--   than its beginner ended, or not closed before its task goes on, or ever; and per help admitted without a principal
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id where the record names none
-- Example: fsar-ledger query invariants/a5_audit_completeness LEDGER
-- The robots are physical facts, the principals are as recorded. No supervisor is needed while that of the executing
-- robot is recorded as absent; a robot without its own is supervised by H_F, who is always there.
WITH calls AS (
    -- A request repeated under the same name before it was denied or closed was sent again.
    SELECT run_id, seq AS told, action_id, type AS call, helper, executed_by AS callee FROM event_principals
    WHERE
        type IN ('RequestIssued.v1', 'RequestAdmitted.v1', 'RequestAccepted.v1', 'RequestDenied.v1', 'RequestClosed.v1')
        OR (type = 'ReassignmentDecided.v1' AND helper IS NOT NULL)
    WINDOW sent AS (PARTITION BY run_id, action_id, request_id, starts_with(type, 'RequestA') ORDER BY seq)
    QUALIFY type <> 'RequestIssued.v1' OR request_id IS NULL OR lag(type) OVER sent IS DISTINCT FROM type
),

phases AS (
    -- An execution rests on the last request to its robot before it began. Its admission may be told again.
    SELECT
        records.run_id, records.seq,
        arg_max(told, (coalesce(coalesce(helper, callee) = records.robot, TRUE), told)) FILTER (
            call IN ('RequestIssued.v1', 'ReassignmentDecided.v1')
        ) AS asked_seq,
        list(told) FILTER (call IN ('RequestAdmitted.v1', 'ReassignmentDecided.v1')) AS admissions,
        max(told) FILTER (call = 'RequestAccepted.v1') AS accepted_seq,
        min(told) FILTER (call = 'RequestClosed.v1' AND records.seq < told) AS closed_seq
    FROM cross_robot_records AS records
    INNER JOIN calls ON records.run_id = calls.run_id AND records.action_id = calls.action_id
    WHERE coalesce(helper = records.robot, TRUE) AND (call = 'RequestClosed.v1' OR told < begun_seq)
    GROUP BY records.run_id, records.seq
),

judged AS (
    SELECT
        records.run_id, records.seq, records.time_us, records.type, records.action_id, records.robot, on_behalf_of,
        list_min(list_filter(admissions, LAMBDA one: one >= coalesce(asked_seq, 0))) AS admitted_seq,
        concat_ws(
            ', ',
            if(requested_by IS DISTINCT FROM on_behalf_of, 'requester ' || coalesce(requested_by, 'missing'), NULL),
            if(executed_by IS DISTINCT FROM records.robot, 'executor ' || coalesce(executed_by, 'missing'), NULL),
            CASE WHEN supervised_by IS NULL AND absences.supervisor IS NULL THEN 'supervisor missing' END,
            if(asked_seq IS NULL, 'no earlier request', NULL),
            if(admitted_seq IS NULL, 'no admission of the request', NULL),
            if(coalesce(accepted_seq, -1) < coalesce(admitted_seq, 0), 'no acceptance after it was admitted', NULL),
            CASE WHEN coalesce(records.robot <> began_by, TRUE) THEN 'begun by ' || coalesce(began_by, 'nobody') END,
            if(
                next_seq < coalesce(closed_seq, next_seq + 1) AND (closed_seq IS NULL OR NOT is_given_up),
                'the task goes on before the request is closed', NULL
            )
        ) AS lacks
    FROM cross_robot_records AS records
    LEFT JOIN phases ON records.run_id = phases.run_id AND records.seq = phases.seq
    LEFT JOIN fleet_members AS members ON records.run_id = members.run_id AND records.robot = members.robot
    LEFT JOIN supervisor_absences AS absences
        ON
            records.run_id = absences.run_id AND members.supervisor = absences.supervisor
            AND records.seq > absences.left_seq AND records.seq < coalesce(absences.returned_seq, records.seq + 1)
)

SELECT
    run_id, seq, time_us, type, action_id,
    robot || ' for ' || coalesce(on_behalf_of, 'nobody') || ': ' || lacks AS found
FROM judged
WHERE lacks <> ''
UNION DISTINCT -- absences overlap where a supervisor is recorded as leaving twice
SELECT
    admitted.run_id, admitted.seq, admitted.time_us, 'AssistanceAdmitted.v1' AS type, admitted.action_id,
    admitted.helper || ' helps ' || admitted.robot || ': a principal is missing' AS found
FROM assistance_admitted AS admitted
LEFT JOIN fleet_members AS members ON admitted.run_id = members.run_id AND admitted.helper = members.robot
LEFT JOIN supervisor_absences AS absences
    ON
        admitted.run_id = absences.run_id AND members.supervisor = absences.supervisor
        AND admitted.seq > absences.left_seq AND admitted.seq < coalesce(absences.returned_seq, admitted.seq + 1)
WHERE requested_by IS NULL OR executed_by IS NULL OR (supervised_by IS NULL AND absences.supervisor IS NULL)
