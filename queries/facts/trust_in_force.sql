-- Title: The trust in force between two robots or roles, by capability and context, from each time it was set
-- Paper: eq:trust
-- Grain: one row per run, robot and peer (or role, peer_role and domain), capability, context and moment at which it
--   was set; before the first there is no trust
-- Key: run_id, robot?, peer?, role?, peer_role?, domain?, capability?, context?, since_us
-- Units: since_us, until_us microseconds of run time, half-open
-- NULL: robot, peer of an entry about roles, one of them of initial trust; role, peer_role, domain of an entry about
--   robots; capability, context when the entry is about all of them; until_us for the last row of an entry; set_by for
--   initial settings of the fleet
-- Example: fsar-ledger query facts/trust_in_force LEDGER
WITH moments AS (
    -- Of several entries about the same subjects at one moment the last holds; among different subjects, precedence
    -- decides.
    SELECT
        run_id, robot, peer, role, peer_role, domain, capability, context,
        time_us AS since_us,
        max(seq) AS seq,
        arg_max(scope, seq) AS trust_scope,
        arg_max_null(set_by, seq) AS set_by,
        arg_max(reason, seq) AS reason,
        max(precedence) AS precedence
    FROM trust_precedence
    GROUP BY run_id, robot, peer, role, peer_role, domain, capability, context, time_us
)

SELECT
    run_id, robot, peer, role, peer_role, domain, capability, context, since_us,
    lead(since_us)
        OVER (PARTITION BY run_id, robot, peer, role, peer_role, domain, capability, context ORDER BY since_us)
        AS until_us,
    trust_scope, set_by, reason, precedence, seq
FROM moments
