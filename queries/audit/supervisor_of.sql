-- Title: The recorded supervisors of an action, and whether each was on shift
-- Paper: eq:supervision
-- Grain: one row per run, action and supervisor that its coordination events and denials name
-- Key: run_id, action_id, supervised_by?
-- Units: first_us, last_us microseconds of run time; first_seq, last_seq positions in the run, for `prove RUN:SEQ`;
--   records and records_off_shift events
-- NULL: supervised_by for the records that name no supervisor; records_off_shift for these as well, and when the run
--   does not observe supervision
-- Example: fsar-ledger query audit/supervisor_of LEDGER --param run=RUN --param action=B1-1/2.1
--   answers supervisor/B1 in 3 records, supervisor/C1 in 4 records, none of them while off shift
-- Parameters: run: run = all, action: action = all
WITH shifts AS (
    SELECT
        run_id, seq, supervisor,
        type = 'SupervisorLeft.v1' AS is_off
    FROM supervision_events
    WHERE type IN ('SupervisorLeft.v1', 'SupervisorReturned.v1')
    UNION ALL
    SELECT run_id, -1 AS seq, name AS supervisor, TRUE AS is_off -- one that returns without having left was away before
    FROM begun_before
    WHERE what = 'absence'
),

supervised AS (
    SELECT run_id, seq, time_us, action_id, supervised_by
    FROM coordination_events
    UNION ALL
    SELECT run_id, seq, time_us, action_id, supervised_by
    FROM denied_actions
),

records AS (
    SELECT
        events.run_id, events.seq, events.time_us, events.action_id, events.supervised_by,
        coalesce(arg_max(shifts.is_off, shifts.seq), FALSE) AS is_off
    FROM supervised AS events
    LEFT JOIN shifts
        ON events.run_id = shifts.run_id AND events.supervised_by = shifts.supervisor AND events.seq > shifts.seq
    WHERE events.action_id IS NOT NULL AND $run IN ('all', events.run_id) AND $action IN ('all', events.action_id)
    GROUP BY events.run_id, events.seq, events.time_us, events.action_id, events.supervised_by
)

SELECT
    records.run_id, records.action_id, records.supervised_by,
    min(records.time_us) AS first_us,
    max(records.time_us) AS last_us,
    min(records.seq) AS first_seq,
    max(records.seq) AS last_seq,
    count(*) AS records,
    CASE
        WHEN records.supervised_by IS NOT NULL AND any_value(list_contains(runs.observes, 'supervision'))
            THEN count_if(records.is_off)
    END AS records_off_shift
FROM records
INNER JOIN runs ON records.run_id = runs.run_id
GROUP BY records.run_id, records.action_id, records.supervised_by
