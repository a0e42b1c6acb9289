-- Title: Share of coordination records from which each principal can be recovered, by recorded field
-- Paper: sec:model:invariants (I5), sec:evaluation:metrics (audit attributability)
-- Grain: one row per run and field: requester, executor, supervisor
-- Key: run_id, field
-- Units: record_count coordination events of the types whose field is recorded; named_count those from which the
--   principal can be recovered; share of them
-- NULL: share where no record of the run has the field; all numbers of a run that declares only concerns and does not
--   observe all that I5 rests on
-- Example: fsar-ledger query audit/attributability_by_field LEDGER answers which principals the records of a run name
-- I5 and the metric judge the three principals together. No real protocol names a supervisor, so such sources are
-- observable only field by field.
WITH recoverable AS (
    SELECT run_id, type, 'requester' AS field, 'requested_by' AS principal, has_origin AS is_named
    FROM coordination_events
    UNION ALL
    SELECT run_id, type, 'executor' AS field, 'executed_by' AS principal, has_executor AS is_named
    FROM coordination_events
    UNION ALL
    SELECT run_id, type, 'supervisor' AS field, 'supervised_by' AS principal, has_supervisor AS is_named
    FROM coordination_events
),

recorded AS (
    SELECT recoverable.run_id, recoverable.field, recoverable.is_named
    FROM recoverable
    INNER JOIN run_started AS runs ON recoverable.run_id = runs.run_id
    INNER JOIN event_concerns AS concerns ON recoverable.type = concerns.type
    WHERE
        list_contains(coalesce(runs.observes, [concerns.concern]), concerns.concern)
        OR list_contains(runs.records, split_part(recoverable.type, '.', 1) || '.' || recoverable.principal)
),

counted AS (
    SELECT run_id, field, count(*) AS record_count, count(*) FILTER (is_named) AS named_count
    FROM recorded
    GROUP BY run_id, field
)

SELECT
    runs.run_id, fields.field,
    if(hidden.run_id IS NULL OR runs.records IS NOT NULL, coalesce(counted.record_count, 0), NULL) AS record_count,
    if(hidden.run_id IS NULL OR runs.records IS NOT NULL, coalesce(counted.named_count, 0), NULL) AS named_count,
    if(hidden.run_id IS NULL OR runs.records IS NOT NULL, counted.named_count / counted.record_count, NULL) AS share
FROM run_started AS runs
CROSS JOIN (VALUES ('requester'), ('executor'), ('supervisor')) AS fields (field)
LEFT JOIN counted ON runs.run_id = counted.run_id AND fields.field = counted.field
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'i5_audit_attributability'
