-- Title: A record lacks nothing if only its supervisor is missing, who was off shift
-- Paper: sec:evaluation:metrics
-- Reading: R8
-- Question: whether an absent supervisor is required
-- Replaces: audit_attributability
-- Moves: audit_attributability
-- Why: The supervision owner is recoverable: the absence is on record, and whose it is; and H_F oversees what a local
--   supervisor does not.
-- Grain: one row per run
-- Key: run_id
-- Units: as in audit_attributability
-- NULL: as in audit_attributability
-- Example: fsar-ledger query readings/absent_supervisors_are_excused LEDGER
WITH counted AS (
    SELECT
        run_id,
        count(*) AS records,
        count(*) FILTER (WHERE record_kind <> 'routine') AS records_without_routine
    FROM off_shift_records
    GROUP BY run_id
),

judged AS (
    SELECT
        measured.* REPLACE (
            measured.numerator + coalesce(counted.records, 0) AS numerator,
            measured.numerator_without_routine
            + coalesce(counted.records_without_routine, 0) AS numerator_without_routine
        )
    FROM audit_attributability AS measured
    LEFT JOIN counted ON measured.run_id = counted.run_id
)

SELECT
    * REPLACE (
        numerator / nullif(denominator, 0) AS value,
        numerator_without_routine / nullif(denominator_without_routine, 0) AS value_without_routine
    )
FROM judged
