-- Title: Revocations of authority, and when each took effect
-- Paper: sec:model:authority
-- Grain: one row per claim whose reason is a revocation, and per AuthorityRevoked event
-- Key: run_id, seq
-- Units: revoked_us, effective_us microseconds of run time; waited_us microseconds
-- NULL: effective_us, waited_us, boundary, action_id of a right when it never took effect; revoked_from when no
--   principal held execution; revoked_by when the record names no decider; capability, context: any
-- Example: fsar-ledger query audit/revocations LEDGER --param run=RUN
--   answers A1-1/7.1: robot/A1 revoked at 51.375 s what robot/D1 executed; effective after its ExecutionFinished, 7.111
--   s later
-- Parameters: run: run = all
WITH claimed AS (
    SELECT
        claims.run_id, claims.seq, claims.action_id,
        claims.claimant AS revoked_by,
        arg_max(held.claimant, held.seq) AS revoked_from,
        claims.began_us AS revoked_us,
        claims.ended_us AS effective_us,
        min(releases.seq) AS release_seq
    FROM claims
    LEFT JOIN claims AS held
        ON
            claims.run_id = held.run_id AND claims.action_id = held.action_id AND claims.seq > held.seq
            AND held.dimension = 'execution' AND claims.began_us < coalesce(held.ended_us, claims.began_us + 1)
    LEFT JOIN authority_released AS releases
        ON
            claims.run_id = releases.run_id AND claims.action_id = releases.action_id AND claims.seq < releases.seq
            AND claims.dimension = releases.dimension AND claims.claimant = releases.claimant
            AND claims.reason = releases.reason
    WHERE claims.reason = 'revocation'
    GROUP BY claims.run_id, claims.seq, claims.action_id, claims.claimant, claims.began_us, claims.ended_us
),

ended AS (
    -- The boundary is the last event of the action before the release, other than claims and releases.
    SELECT
        claimed.run_id, claimed.seq, claimed.action_id, claimed.revoked_by, claimed.revoked_from, claimed.revoked_us,
        claimed.effective_us,
        'context changed' AS reason,
        arg_max(events.type, events.seq) AS boundary
    FROM claimed
    LEFT JOIN event_principals AS events
        ON
            claimed.run_id = events.run_id AND claimed.action_id = events.action_id AND claimed.seq < events.seq
            AND claimed.release_seq > events.seq AND events.type NOT IN ('AuthorityClaimed.v1', 'AuthorityReleased.v1')
    GROUP BY ALL
),

withdrawn AS (
    -- A revocation takes effect at the first request that is denied for it while no later event changes that right.
    SELECT
        revoked.run_id, revoked.seq,
        arg_min(denials.action_id, denials.seq) AS action_id,
        revoked.decided_by AS revoked_by,
        revoked.requested_by AS revoked_from,
        revoked.reason, revoked.capability, revoked.context,
        revoked.time_us AS revoked_us,
        min(denials.time_us) AS effective_us,
        arg_min(denials.type, denials.seq) AS boundary
    FROM authority_revoked AS revoked
    LEFT JOIN rights_at_evaluations AS denials
        ON revoked.run_id = denials.run_id AND revoked.seq = denials.right_seq AND denials.conjunct = 'authority'
    GROUP BY ALL
),

every AS (
    SELECT * FROM ended
    UNION ALL BY NAME
    SELECT * FROM withdrawn
)

SELECT
    run_id, seq, action_id, revoked_by, revoked_from, revoked_us, effective_us, reason, boundary, capability, context,
    effective_us - revoked_us AS waited_us
FROM every
WHERE $run IN ('all', run_id)
