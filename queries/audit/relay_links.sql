-- Title: Chains through a relay, link by link: each receiver's trust in its sender, and the trust between the ends
-- Paper: eq:nontransitive
-- Grain: one row per link (two for a chain: requester to relay, relay to executor) of each request through a relay
-- Key: run_id, asked_seq, link
-- Units: link number of the link from 1; passed_us microseconds of run time
-- NULL: action_id, sender, receiver when the record does not name them; passed_us, seq when the relay did not pass it
--   on; a trust scope that had not been set by then; is_trusted also when the run does not observe fleet and trust
-- Example: fsar-ledger query audit/relay_links LEDGER --param run=RUN
--   answers link 1 robot/D1 to robot/A1 (capability), link 2 robot/A1 to robot/B1 (task); robot/B1 has set none for
--   robot/D1
-- Parameters: run: run = all, action: action = all
WITH passed AS (
    -- A relay passes on the last request that it received.
    SELECT relayed.run_id, relayed.seq, relayed.time_us, max(asked.seq) AS asked_seq
    FROM request_relayed AS relayed
    INNER JOIN request_issued AS asked
        ON
            relayed.run_id = asked.run_id AND relayed.action_id = asked.action_id AND relayed.seq > asked.seq
            AND coalesce(relayed.decided_by = asked.relay, asked.relay IS NOT NULL)
    GROUP BY relayed.run_id, relayed.seq, relayed.time_us
),

chains AS (
    SELECT
        asked.run_id, asked.action_id, asked.requested_by, asked.relay, asked.executed_by, asked.capability,
        asked.seq AS asked_seq, asked.time_us AS asked_us, asked.task_id AS context,
        min(passed.seq) AS relayed_seq, min(passed.time_us) AS relayed_us
    FROM request_issued AS asked
    LEFT JOIN passed ON asked.run_id = passed.run_id AND asked.seq = passed.asked_seq
    WHERE asked.relay IS NOT NULL AND $run IN ('all', asked.run_id) AND $action IN ('all', asked.action_id)
    GROUP BY ALL
),

links AS (
    SELECT
        chains.run_id, chains.action_id, chains.asked_seq, chains.requested_by, chains.executed_by, chains.capability,
        chains.context, numbers.link,
        CASE numbers.link WHEN 1 THEN chains.asked_seq ELSE chains.relayed_seq END AS seq,
        CASE numbers.link WHEN 1 THEN chains.asked_us ELSE chains.relayed_us END AS passed_us,
        CASE numbers.link WHEN 1 THEN chains.requested_by ELSE chains.relay END AS sender,
        CASE numbers.link WHEN 1 THEN chains.relay ELSE chains.executed_by END AS receiver
    FROM chains
    CROSS JOIN (VALUES (1), (2)) AS numbers (link)
),

judged AS (
    SELECT
        links.run_id, links.action_id, links.asked_seq, links.link, links.seq, links.passed_us, links.sender,
        links.receiver,
        arg_max(scopes.scope, scopes.precedence) FILTER (
            WHERE links.receiver = trusting.robot AND links.sender = trusted.robot
        ) AS link_scope,
        arg_max(scopes.scope, scopes.precedence) FILTER (
            WHERE links.executed_by = trusting.robot AND links.requested_by = trusted.robot
        ) AS direct_scope
    FROM links
    LEFT JOIN trust_parties AS trusting
        ON
            links.run_id = trusting.run_id AND trusting.is_trusting AND coalesce(links.seq, asked_seq) > trusting.seq
            AND trusting.robot IN (links.receiver, links.executed_by)
    LEFT JOIN trust_parties AS trusted
        ON
            trusting.run_id = trusted.run_id AND trusting.seq = trusted.seq AND NOT trusted.is_trusting
            AND trusted.robot IN (links.sender, links.requested_by)
    LEFT JOIN trust_precedence AS scopes
        ON
            trusted.run_id = scopes.run_id AND trusted.seq = scopes.seq
            AND coalesce(links.capability = scopes.capability, scopes.capability IS NULL)
            AND coalesce(links.context = scopes.context, scopes.context IS NULL)
    GROUP BY ALL
)

SELECT
    judged.run_id, judged.action_id, judged.asked_seq, judged.link, judged.seq, judged.passed_us, judged.sender,
    judged.receiver, judged.link_scope,
    if(list_has_all(runs.observes, ['fleet', 'trust']), coalesce(judged.link_scope, 'none') <> 'none', NULL)
        AS is_trusted,
    judged.direct_scope
FROM judged
INNER JOIN runs ON judged.run_id = runs.run_id
