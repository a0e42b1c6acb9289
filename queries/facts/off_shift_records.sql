-- Title: Records that lack nothing but a supervisor who was off shift at that moment
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per coordination event
-- Key: run_id, seq
-- Units: seq position in the run
-- NULL: never
-- Example: fsar-ledger query facts/off_shift_records LEDGER
SELECT DISTINCT records.run_id, records.seq, records.record_kind
FROM coordination_events AS records
INNER JOIN supervisor_absences AS absences
    ON
        records.run_id = absences.run_id AND replace(records.part_of, 'robot/', 'supervisor/') = absences.supervisor
        AND records.seq > absences.left_seq AND records.seq < coalesce(absences.returned_seq, records.seq + 1)
WHERE records.has_origin AND records.has_executor AND NOT records.has_supervisor
