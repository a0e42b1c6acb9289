-- Title: A record lacks nothing if only its supervisor is missing, who was off shift
-- Paper: sec:evaluation:metrics
-- Reading: R8
-- Question: whether an absent supervisor is required
-- Replaces: audit_attributability
-- Moves: audit_attributability
-- Why: The supervision owner is recoverable: the absence is on record, and whose it is; and H_F oversees what a local supervisor does not.
-- Grain: one row per run
-- Units: as in audit_attributability
-- NULL: as in audit_attributability
-- Example: fsar-ledger query readings/absent_supervisors_are_excused LEDGER
WITH records AS (
    SELECT
        records.run_id,
        records.seq,
        records.record_kind,
        records.is_attributable OR (records.has_origin AND records.has_executor AND bool_or(absences.run_id IS NOT NULL)) AS is_attributable
    FROM coordination_events AS records
    LEFT JOIN supervisor_absences AS absences
        ON
            records.run_id = absences.run_id
            AND replace(records.part_of, 'robot/', 'supervisor/') = absences.supervisor
            AND records.seq > absences.left_seq
            AND records.seq < coalesce(absences.returned_seq, records.seq + 1)
    GROUP BY records.run_id, records.seq, records.record_kind, records.is_attributable, records.has_origin, records.has_executor
),

judged AS (
    SELECT
        run_id,
        count(*) FILTER (WHERE is_attributable) AS numerator,
        count(*) FILTER (WHERE is_attributable AND record_kind <> 'routine') AS numerator_without_routine
    FROM records
    GROUP BY run_id
)

SELECT
    measured.* REPLACE (
        CASE WHEN measured.not_observed IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
        CASE WHEN measured.not_observed IS NULL THEN judged.numerator / nullif(measured.denominator, 0) END AS value,
        CASE WHEN measured.not_observed IS NULL THEN coalesce(judged.numerator_without_routine, 0)::BIGINT END AS numerator_without_routine,
        CASE WHEN measured.not_observed IS NULL THEN judged.numerator_without_routine / nullif(measured.denominator_without_routine, 0) END
            AS value_without_routine
    )
FROM audit_attributability AS measured
LEFT JOIN judged ON measured.run_id = judged.run_id
