-- Title: The last grant or revocation that bears on each evaluation of a request, for each robot behind the request
-- Paper: eq:auth, sec:model:authority
-- Grain: one row per evaluation and requesting robot: the requester and, where the request came through one, the relay
-- Key: run_id, seq, asker
-- Units: time_us microseconds of run time; right_seq position in the run
-- NULL: action_id; conjunct unless denied; no row where no right that the request is about was granted or revoked
-- Example: fsar-ledger query facts/rights_at_evaluations LEDGER
-- Stored: several invariants of an audit read it
WITH askers AS (
    -- A relay judges only its own link of the chain.
    SELECT
        run_id, seq, time_us, action_id, context, capability, type, verdict, conjunct,
        CASE WHEN decided_by = relay THEN relay ELSE executed_by END AS executed_by,
        unnest(list_distinct([requested_by, coalesce(relay, requested_by)])) AS asker
    FROM evaluations
),

rights AS (
    -- A grant also bears on a request of which the record does not say whether it is about it.
    SELECT
        run_id, seq, type, requested_by, executed_by, capability, context,
        type = 'AuthorityGranted.v1' AS may_bear
    FROM authority_events
    WHERE type IN ('AuthorityGranted.v1', 'AuthorityRevoked.v1')
)

SELECT
    askers.run_id, askers.seq, askers.time_us, askers.action_id, askers.type, askers.verdict, askers.conjunct,
    askers.executed_by, askers.asker,
    max(rights.seq) AS right_seq,
    arg_max(rights.type, rights.seq) = 'AuthorityRevoked.v1' AS is_revoked
FROM askers
INNER JOIN rights
    ON
        askers.run_id = rights.run_id AND askers.seq > rights.seq AND askers.asker = rights.requested_by
        AND coalesce(askers.executed_by = rights.executed_by, rights.executed_by IS NULL OR rights.may_bear)
        AND coalesce(askers.capability = rights.capability, rights.capability IS NULL OR rights.may_bear)
        AND coalesce(askers.context = rights.context, rights.context IS NULL OR rights.may_bear)
GROUP BY ALL
