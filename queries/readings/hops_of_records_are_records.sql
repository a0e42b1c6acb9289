-- Title: Each hop between agents on the way to a record is a record, too
-- Paper: sec:evaluation:qualitative
-- Reading: R21
-- Question: whether internal hand-offs are records
-- Replaces: coordination_events
-- Moves: audit_attributability
-- Why: The case names the hand-off of delegated work as its example; what agents say on the way to what they record
--   carries no origin either.
-- Grain: one row per record, and per hop on its path
-- Key: none, a hop has no position of its own
-- Units: as in coordination_events; a hop has the position, time and kind of the record
-- NULL: as in coordination_events; a hop names no principal but the executor, and belongs to no task or action
-- Example: fsar-ledger query readings/hops_of_records_are_records LEDGER
WITH hops AS (
    SELECT
        run_id, seq, decided_by,
        unnest(range(len(path) - 1)) AS hop
    FROM decisions
    WHERE starts_with(decided_by, 'agent/')
)

SELECT *
FROM coordination_events
UNION ALL BY NAME
SELECT
    records.run_id, records.seq, records.time_us, records.type, records.record_kind,
    'robot/' || split_part(hops.decided_by, '/', 2) AS executed_by,
    'robot/' || split_part(hops.decided_by, '/', 2) AS part_of,
    FALSE AS has_origin,
    TRUE AS has_executor,
    FALSE AS has_supervisor,
    FALSE AS is_off_shift,
    FALSE AS is_attributable
FROM coordination_events AS records
INNER JOIN hops ON records.run_id = hops.run_id AND records.seq = hops.seq
