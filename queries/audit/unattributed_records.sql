-- Title: The unattributed records of a run, by kind, and the principals they lack
-- Paper: sec:evaluation:metrics (audit attributability), sec:model:invariants (I5)
-- Grain: one row per run and kind of record with at least one unattributable record
-- Key: run_id, record_kind
-- Units: records of the kind, and those of them that lack a principal, even by way of their action
-- NULL: never
-- Example: fsar-ledger query audit/unattributed_records LEDGER --param run=RUN
--   answers handoff: 92 of 92 records; 92 lack the requester, none the executor, 5 the supervisor
-- Parameters: run: run = all, kind: record = all
SELECT
    run_id, record_kind,
    count(*) AS records,
    count_if(NOT is_attributable) AS unattributed,
    count_if(NOT has_origin) AS without_origin,
    count_if(NOT has_executor) AS without_executor,
    count_if(NOT has_supervisor) AS without_supervisor
FROM coordination_events
WHERE $run IN ('all', run_id) AND $kind IN ('all', record_kind)
GROUP BY run_id, record_kind
HAVING count_if(NOT is_attributable) > 0
