-- Title: I5 broken: a coordination event from which a principal cannot be recovered
-- Paper: sec:model:invariants (I5), sec:evaluation:metrics (audit attributability)
-- Grain: one row per coordination event that lacks a requester, an executor, or a supervisor who is not recorded as
--   absent
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when the record is not correlated with an action
-- Example: fsar-ledger query invariants/i5_audit_attributability LEDGER
-- A principal counts when the record or another event of its action names it. The supervisor that may be absent is that
-- of the robot that decided; where no robot did, of the requester until the request is issued, and of the executor
-- after that. A robot without a supervisor of its own is supervised by H_F, who is always there.
WITH lacking AS (
    SELECT
        run_id, seq, time_us, type, action_id, has_origin, has_executor, has_supervisor,
        'robot/' || split_part(
            CASE
                WHEN starts_with(decided_by, 'robot/') OR starts_with(decided_by, 'agent/') THEN decided_by
                WHEN record_kind IN ('gap', 'query', 'request') THEN coalesce(requested_by, executed_by)
                ELSE coalesce(executed_by, requested_by)
            END, '/', 2
        ) AS robot
    FROM coordination_events
    WHERE NOT is_attributable
),

judged AS (
    SELECT
        lacking.run_id, lacking.seq, lacking.time_us, lacking.type, lacking.action_id, lacking.has_origin,
        lacking.has_executor,
        NOT lacking.has_supervisor AND absences.supervisor IS NULL AS lacks_supervisor
    FROM lacking
    LEFT JOIN fleet_members AS members ON lacking.run_id = members.run_id AND lacking.robot = members.robot
    LEFT JOIN supervisor_absences AS absences
        ON
            lacking.run_id = absences.run_id AND members.supervisor = absences.supervisor
            AND lacking.seq > absences.left_seq AND lacking.seq < coalesce(absences.returned_seq, lacking.seq + 1)
)

SELECT
    run_id, seq, time_us, type, action_id,
    'no ' || concat_ws(
        ', no ',
        CASE WHEN NOT has_origin THEN 'requester' END,
        CASE WHEN NOT has_executor THEN 'executor' END,
        CASE WHEN lacks_supervisor THEN 'supervisor' END
    ) || ' can be recovered' AS found
FROM judged
WHERE NOT has_origin OR NOT has_executor OR lacks_supervisor
