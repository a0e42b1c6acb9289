-- Title: Coordination events, and the principals that can be recovered from each
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per event of a coordination type
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: decided_by, or a principal, that the row itself does not record; action_id when the record is not correlated
--   with an action; part_of when it names no robot
-- The supervisor is the robot's own where it has one, else H_F. While the own supervisor is recorded as absent
-- (is_off_shift), no record names one, and the owner can be recovered from the record of the absence (R8).
-- Example: fsar-ledger query facts/coordination_events LEDGER
WITH classified AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.type, event_classes.record_kind, events.task_id,
        events.action_id, events.decided_by, events.requested_by, events.executed_by, events.supervised_by,
        event_classes.requires_origin, event_classes.requires_executor, event_classes.requires_supervisor,
        CASE event_classes.part
            WHEN 'requester' THEN events.requested_by
            ELSE coalesce(
                events.executed_by,
                events.robot,
                'robot/' || nullif(regexp_extract(events.decided_by, '^(?:robot|agent)/([^/]+)', 1), ''),
                events.requested_by
            )
        END AS part_of
    FROM event_principals AS events
    INNER JOIN event_classes ON events.type = event_classes.type
),

parts AS (
    SELECT
        run_id, action_id, part_of,
        count(requested_by) > 0 AS has_origin,
        count(executed_by) > 0 AS has_executor,
        count(supervised_by) > 0 AS has_supervisor
    FROM classified
    WHERE action_id IS NOT NULL AND part_of IS NOT NULL
    GROUP BY run_id, action_id, part_of
),

absent AS (
    SELECT DISTINCT classified.run_id, classified.seq
    FROM classified
    INNER JOIN fleet_members AS members
        ON classified.run_id = members.run_id AND classified.part_of = members.robot
    INNER JOIN supervisor_absences AS absences
        ON
            members.run_id = absences.run_id AND members.supervisor = absences.supervisor
            AND classified.seq > absences.left_seq
            AND classified.seq < coalesce(absences.returned_seq, classified.seq + 1)
    WHERE classified.supervised_by IS NULL AND classified.requires_supervisor
),

judged AS (
    SELECT
        records.run_id, records.seq, records.time_us, records.type, records.record_kind, records.task_id,
        records.action_id, records.decided_by, records.requested_by, records.executed_by, records.supervised_by,
        records.part_of,
        records.requested_by IS NOT NULL
        OR NOT records.requires_origin
        OR coalesce(parts.has_origin, FALSE) AS has_origin,
        records.executed_by IS NOT NULL
        OR NOT records.requires_executor
        OR coalesce(parts.has_executor, FALSE) AS has_executor,
        records.supervised_by IS NOT NULL
        OR NOT records.requires_supervisor
        OR coalesce(parts.has_supervisor, FALSE)
        OR absent.seq IS NOT NULL AS has_supervisor,
        absent.seq IS NOT NULL AND NOT coalesce(parts.has_supervisor, FALSE) AS is_off_shift
    FROM classified AS records
    LEFT JOIN parts
        ON records.run_id = parts.run_id AND records.action_id = parts.action_id AND records.part_of = parts.part_of
    LEFT JOIN absent ON records.run_id = absent.run_id AND records.seq = absent.seq
    WHERE records.record_kind IS NOT NULL
)

SELECT
    run_id, seq, time_us, type, record_kind, task_id, action_id, part_of, decided_by, requested_by, executed_by,
    supervised_by, has_origin, has_executor, has_supervisor, is_off_shift,
    has_origin AND has_executor AND has_supervisor AS is_attributable
FROM judged
