-- Title: The trust in force at a time
-- Paper: eq:trust
-- Grain: one row per run, ordered pair of robots and entry about it that had been set by then; with a capability or
--   context as parameter, only the entry that holds
-- Key: run_id, robot, peer, seq
-- Units: since_us (not before both were members), until_us microseconds of run time, half-open; at seconds, by default
--   after the end of every run; seq position in the run of the entry, for `prove RUN:SEQ`
-- NULL: role, peer_role, domain of an entry about the very pair; capability, context when the entry is about all of
--   them; until_us when it was not set again; set_by for initial settings of the fleet; a pair without a row had no
--   trust
-- Example: fsar-ledger query audit/trust_at LEDGER --param run=RUN --param robot=robot/B1 --param peer=robot/A1
--   --param at=30
--   answers robot/B1 trusts robot/A1 with scope task since 0, as every robot of role B trusts those of role A, for
--   every capability and context
-- Parameters: run: run = all, robot: robot = all, peer: robot = all, capability: capability = all,
--   context: context = all, at: time = end
WITH peers AS (
    -- DuckDB cannot copy the plan of a function of two columns with the same name, which a macro requires.
    SELECT run_id, seq, robot, joined_us AS peer_joined_us
    FROM trust_parties
    WHERE NOT is_trusting
),

entries AS (
    SELECT
        found.run_id, found.role, found.peer_role, found.domain, found.capability, found.context,
        greatest(found.since_us, trusting.joined_us, trusted.peer_joined_us) AS since_us,
        found.until_us, found.trust_scope, found.set_by, found.reason, found.precedence, found.seq, trusting.robot,
        trusted.robot AS peer,
        $capability = 'all' AND $context = 'all' AS is_listed
    FROM trust_in_force AS found
    INNER JOIN trust_parties AS trusting
        ON found.run_id = trusting.run_id AND found.seq = trusting.seq AND trusting.is_trusting
    INNER JOIN peers AS trusted ON found.run_id = trusted.run_id AND found.seq = trusted.seq
    WHERE
        $run IN ('all', found.run_id) AND $robot IN ('all', trusting.robot) AND $peer IN ('all', trusted.robot)
        AND trusting.robot <> trusted.robot
        AND greatest(found.since_us, trusting.joined_us, trusted.peer_joined_us) <= $at_us::BIGINT
        AND (found.until_us IS NULL OR found.until_us > $at_us::BIGINT)
)

SELECT
    run_id, robot, peer, role, peer_role, domain, capability, context, trust_scope, since_us, until_us, set_by, reason,
    seq
FROM entries
WHERE is_listed OR ((capability IS NULL OR capability = $capability) AND (context IS NULL OR context = $context))
QUALIFY is_listed OR row_number() OVER (PARTITION BY run_id, robot, peer ORDER BY precedence DESC) = 1
