-- Title: Executions for another robot, and whether trust reached from the executor to that robot
-- Paper: eq:trust, eq:nontransitive
-- Grain: one row per ExecutionStarted event of a robot on behalf of another
-- Key: run_id, seq
-- Units: none
-- NULL: both when the run does not observe fleet and trust; is_direct: the executor itself trusted the other robot;
--   is_chained: each link through the relay that passed the request on was trusted
-- Example: fsar-ledger query facts/delegated_trust LEDGER
WITH delegated AS (
    -- Trust counts at the time of the executor's admission, or of its start where it admitted no request.
    SELECT
        done.run_id, done.seq, done.task_id, done.action_id, done.capability,
        done.robot AS executor,
        done.on_behalf_of AS requester,
        coalesce(admitted.seq, done.seq) AS trusted_by_seq
    FROM executions AS done
    ASOF LEFT JOIN request_admitted AS admitted
        ON
            done.run_id = admitted.run_id AND done.action_id = admitted.action_id
            AND done.robot = admitted.executed_by AND done.seq > admitted.seq
    WHERE done.robot <> done.on_behalf_of
),

links AS (
    SELECT
        delegated.run_id, delegated.seq, delegated.task_id, delegated.action_id, delegated.capability,
        delegated.trusted_by_seq,
        unnest(
            CASE
                WHEN relayed.decided_by IS NULL THEN [{ 'trusting': executor, 'trusted': requester, 'is_direct': TRUE }]
                ELSE [
                    { 'trusting': executor, 'trusted': requester, 'is_direct': TRUE },
                    { 'trusting': executor, 'trusted': relayed.decided_by, 'is_direct': FALSE },
                    { 'trusting': relayed.decided_by, 'trusted': requester, 'is_direct': FALSE }
                ]
            END
        ) AS link
    FROM delegated
    -- The last relay by then: earlier and later relays belong to other requests for the action.
    ASOF LEFT JOIN request_relayed AS relayed
        ON
            delegated.run_id = relayed.run_id AND delegated.action_id = relayed.action_id
            AND delegated.trusted_by_seq > relayed.seq
),

scopes AS (
    SELECT
        links.run_id, links.seq,
        links.link.is_direct,
        coalesce(arg_max(trust.scope, trust.precedence), 'none') <> 'none' AS is_trusted
    FROM links
    LEFT JOIN trust_parties AS trusting
        ON
            links.run_id = trusting.run_id AND links.link.trusting = trusting.robot AND trusting.is_trusting
            AND links.trusted_by_seq > trusting.seq
    LEFT JOIN trust_parties AS trusted
        ON
            trusting.run_id = trusted.run_id AND trusting.seq = trusted.seq AND links.link.trusted = trusted.robot
            AND NOT trusted.is_trusting
    LEFT JOIN trust_precedence AS trust
        ON
            trusted.run_id = trust.run_id AND trusted.seq = trust.seq
            AND links.capability = coalesce(trust.capability, links.capability)
            AND links.task_id = coalesce(trust.context, links.task_id)
    GROUP BY links.run_id, links.seq, links.action_id, links.link
)

SELECT
    scopes.run_id, scopes.seq,
    if(
        any_value(list_has_all(runs.observes, ['fleet', 'trust'])),
        coalesce(bool_or(scopes.is_trusted) FILTER (scopes.is_direct), FALSE), NULL
    ) AS is_direct,
    if(
        any_value(list_has_all(runs.observes, ['fleet', 'trust'])),
        coalesce(bool_and(scopes.is_trusted) FILTER (NOT scopes.is_direct), FALSE), NULL
    ) AS is_chained
FROM scopes
INNER JOIN runs ON scopes.run_id = runs.run_id
GROUP BY scopes.run_id, scopes.seq
