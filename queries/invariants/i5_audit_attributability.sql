-- Title: I5 broken: a coordination event from which a principal cannot be recovered
-- Paper: sec:model:invariants (I5), sec:evaluation:metrics (audit attributability)
-- Grain: one row per coordination event that lacks a requester, an executor, or a supervisor
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when the record is not correlated with an action
-- Example: fsar-ledger query invariants/i5_audit_attributability LEDGER
-- Whether a principal can be recovered is judged in coordination_events, as for the metric: a recorded absence excuses
-- a missing supervisor.
SELECT
    run_id, seq, time_us, type, action_id,
    'no ' || concat_ws(
        ', no ',
        CASE WHEN NOT has_origin THEN 'requester' END,
        CASE WHEN NOT has_executor THEN 'executor' END,
        CASE WHEN NOT has_supervisor THEN 'supervisor' END
    ) || ' can be recovered' AS found
FROM coordination_events
WHERE NOT is_attributable
