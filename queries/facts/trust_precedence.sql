-- Title: Entries of trust, with the precedence that decides for a pair
-- Paper: eq:trust
-- Grain: one row per TrustSet, RoleTrustSet or InitialTrustSet event
-- Key: run_id, seq
-- Units: time_us microseconds of run time; precedence orders the entries that apply to one robot about one peer
-- NULL: robot, peer of an entry about roles, and the party of an initial trust that stands for all robots; role,
--   peer_role, domain of an entry about robots (an empty domain is the whole fleet); capability, context when the entry
--   is about all of them; set_by for initial settings of the fleet
-- Example: fsar-ledger query facts/trust_precedence LEDGER
-- Of the entries that apply to a pair (see trust_parties), a capability and a context, the one of the greatest
-- precedence holds. An entry about the pair itself precedes those about roles; among roles, the smallest domain comes
-- first; initial trust of a robot that joined the running fleet comes last. Then an entry that names both capability
-- and context precedes one with the capability alone, that one with the context alone, and that one with neither;
-- among equals, the last holds.
WITH entries AS (
    SELECT
        run_id, seq, time_us, robot, peer, scope, capability, context, decided_by, reason,
        NULL AS role,
        NULL AS peer_role,
        NULL AS domain,
        1024 AS nearness
    FROM trust_set
    UNION ALL BY NAME
    SELECT
        run_id, seq, time_us, role, peer_role, scope, domain, capability, context, decided_by, reason,
        NULL AS robot,
        NULL AS peer,
        CASE domain WHEN '' THEN 0 ELSE least(len(string_split(domain, '/')), 1023) END AS nearness
    FROM role_trust_set
    UNION ALL BY NAME
    SELECT
        run_id, seq, time_us, scope, decided_by,
        'initial' AS reason,
        CASE WHEN is_trusting THEN robot END AS robot,
        CASE WHEN NOT is_trusting THEN robot END AS peer,
        -1 AS nearness
    FROM initial_trust_set
)

SELECT
    run_id, seq, time_us, robot, peer, role, peer_role, domain, capability, context, scope,
    decided_by AS set_by,
    reason,
    (nearness::BIGINT * 4 + (capability IS NOT NULL)::BIGINT * 2 + (context IS NOT NULL)::BIGINT) * 1000000000
    + seq AS precedence
FROM entries
