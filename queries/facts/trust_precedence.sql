-- Title: Entries of trust, and which of those that apply holds
-- Paper: eq:trust
-- Grain: one row per TrustSet event
-- Units: time_us microseconds of run time; precedence orders the entries of one robot about one peer
-- NULL: capability, context when the entry is about all of them; set_by for what the fleet was founded with
-- Example: fsar-ledger query facts/trust_precedence LEDGER
-- Of the entries that apply to a capability and a context, that of the greatest precedence holds: both named, then the capability, then the context,
-- then neither; of equals the last.
SELECT
    run_id,
    seq,
    time_us,
    robot,
    peer,
    capability,
    context,
    scope,
    decided_by AS set_by,
    reason,
    ((capability IS NOT NULL)::BIGINT * 2 + (context IS NOT NULL)::BIGINT) * 1000000000 + seq AS precedence
FROM trust_set
