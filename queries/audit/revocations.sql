-- Title: Revocations of authority, and when each took effect
-- Paper: eq:nontransitive, sec:model:authority
-- Grain: one row per claim whose reason is a revocation
-- Units: revoked_us, effective_us microseconds of run time; waited_us microseconds
-- NULL: effective_us, waited_us when it never took effect; revoked_from when nobody held execution then; boundary when the record shows none
-- Example: fsar-ledger query audit/revocations LEDGER --param run=RUN
--   answers A1-1/7.1: robot/A1 revoked at 51.375 s what robot/D1 executed; effective after its ExecutionFinished, 7.111 s later
-- Parameters: run = all
WITH revoked AS (
    SELECT
        claims.run_id,
        claims.seq,
        claims.action_id,
        claims.claimant,
        claims.began_us,
        claims.ended_us,
        min(releases.seq) AS release_seq
    FROM claims
    LEFT JOIN authority_released AS releases
        ON
            claims.run_id = releases.run_id
            AND claims.action_id = releases.action_id
            AND claims.dimension = releases.dimension
            AND claims.claimant = releases.claimant
            AND claims.reason = releases.reason
            AND claims.seq < releases.seq
    WHERE claims.reason = 'revocation' AND $run IN ('all', claims.run_id)
    GROUP BY ALL
),

held AS (
    SELECT
        revoked.run_id,
        revoked.seq,
        arg_max(claims.claimant, claims.seq) AS revoked_from
    FROM revoked
    INNER JOIN claims
        ON
            revoked.run_id = claims.run_id
            AND revoked.action_id = claims.action_id
            AND claims.dimension = 'execution'
            AND revoked.seq > claims.seq
            AND (claims.ended_us IS NULL OR revoked.began_us < claims.ended_us)
    GROUP BY revoked.run_id, revoked.seq
),

boundaries AS (
    -- What happened to the action just before the release, apart from other claims and releases.
    SELECT
        revoked.run_id,
        revoked.seq,
        arg_max(events.type, events.seq) AS boundary
    FROM revoked
    INNER JOIN events
        ON revoked.run_id = events.run_id AND revoked.action_id = events.action_id AND revoked.seq < events.seq AND revoked.release_seq > events.seq
    WHERE events.type NOT IN ('AuthorityClaimed.v1', 'AuthorityReleased.v1')
    GROUP BY revoked.run_id, revoked.seq
)

SELECT
    revoked.run_id,
    revoked.seq,
    revoked.action_id,
    revoked.claimant AS revoked_by,
    held.revoked_from,
    revoked.began_us AS revoked_us,
    revoked.ended_us AS effective_us,
    revoked.ended_us - revoked.began_us AS waited_us,
    boundaries.boundary
FROM revoked
LEFT JOIN held ON revoked.run_id = held.run_id AND revoked.seq = held.seq
LEFT JOIN boundaries ON revoked.run_id = boundaries.run_id AND revoked.seq = boundaries.seq
