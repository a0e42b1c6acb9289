-- Title: Delegation chains: how each executor judged its own link, and whether the chain is well-formed
-- Paper: eq:nontransitive
-- Grain: one row per action, as it was last requested, within each chain of two or more links that it belongs to
-- Key: run_id, chain, action_id
-- Units: link number of the link on record from 1; asked_us microseconds of run time of the last request
-- NULL: an unnamed principal; verdict, conjunct, trust of a link that is not judged; conjunct unless denied;
--   is_well_formed while a link is open in a live or foreign run, is not judged in a run that does not observe request,
--   or serves a request not on record; end_scope then, or before the link's executor set trust in the first requester
-- Example: fsar-ledger query audit/delegation_chains LEDGER --param run=RUN
--   answers link 1 robot/A1 to robot/B1 (task, admitted), link 2 robot/B1 to robot/C1 (session, admitted): well-formed
-- Parameters: run: run = all, action: action = all
WITH RECURSIVE asks AS (
    SELECT run_id, seq, action_id, parent, requested_by, min(seq) OVER (PARTITION BY run_id, action_id) AS first_seq
    FROM request_issued
    WHERE action_id IS NOT NULL AND $run IN ('all', run_id)
    QUALIFY seq = max(seq) OVER (PARTITION BY run_id, action_id)
),

chains AS (
    SELECT
        asks.run_id, asks.seq, asks.first_seq, asks.action_id AS chain, asks.action_id,
        asks.requested_by AS first_requester, asks.parent IS NULL AS is_whole, 1 AS link
    FROM asks
    ANTI JOIN asks AS served ON asks.run_id = served.run_id AND asks.parent = served.action_id
    WHERE $action IN ('all', asks.action_id)
    UNION ALL
    SELECT
        asks.run_id, asks.seq, asks.first_seq, chains.chain, asks.action_id,
        chains.first_requester, chains.is_whole, chains.link + 1 AS link
    FROM chains  -- A request follows the one that it serves; a forged record that claims otherwise is no link.
    INNER JOIN asks
        ON chains.run_id = asks.run_id AND chains.action_id = asks.parent AND chains.first_seq < asks.first_seq
),

judged AS (
    SELECT * FROM evaluations
    QUALIFY row_number() OVER (PARTITION BY run_id, asked_seq ORDER BY seq DESC) = 1
),

ends AS (
    SELECT chains.run_id, chains.chain, chains.seq, arg_max(trust.scope, trust.precedence) AS end_scope
    FROM chains
    INNER JOIN request_issued AS asked ON chains.run_id = asked.run_id AND chains.seq = asked.seq
    INNER JOIN trust_parties AS own
        ON chains.run_id = own.run_id AND asked.executed_by = own.robot AND own.is_trusting AND chains.seq > own.seq
    INNER JOIN trust_parties AS peers
        ON own.run_id = peers.run_id AND own.seq = peers.seq AND chains.first_requester = peers.robot
    INNER JOIN trust_precedence AS trust ON own.run_id = trust.run_id AND own.seq = trust.seq
    WHERE
        NOT peers.is_trusting AND chains.is_whole
        AND coalesce(asked.capability = trust.capability, trust.capability IS NULL)
        AND coalesce(asked.task_id = trust.context, trust.context IS NULL)
    GROUP BY chains.run_id, chains.chain, chains.seq
)

SELECT
    chains.run_id, chains.chain, chains.link, chains.action_id, asked.time_us AS asked_us,
    asked.requested_by, asked.executed_by, asked.capability, judged.trust, judged.verdict, judged.conjunct,
    CASE
        WHEN bool_or(judged.verdict = 'denied') OVER links THEN FALSE
        WHEN NOT chains.is_whole THEN NULL
        WHEN count(*) FILTER (judged.verdict = 'admitted') OVER links = count(*) OVER links THEN TRUE
        -- Such a record ends where it was read: a request still waiting for an answer is open, not an offence.
        WHEN
            runs.kind IN ('live', 'foreign') AND bool_or(
                judged.verdict IS DISTINCT FROM 'admitted'
                AND coalesce(greatest(acts.begun_seq, acts.refused_seq, acts.result_seq), 0) < chains.seq
            ) OVER links
            THEN NULL
        WHEN bool_or(judged.verdict = 'countered') OVER links OR list_contains(runs.observes, 'request') THEN FALSE
    END AS is_well_formed,
    ends.end_scope
FROM chains
INNER JOIN request_issued AS asked ON chains.run_id = asked.run_id AND chains.seq = asked.seq
INNER JOIN runs ON chains.run_id = runs.run_id
LEFT JOIN action_records AS acts ON chains.run_id = acts.run_id AND chains.action_id = acts.action_id
LEFT JOIN judged ON chains.run_id = judged.run_id AND chains.seq = judged.asked_seq
LEFT JOIN ends ON chains.run_id = ends.run_id AND chains.chain = ends.chain AND chains.seq = ends.seq
WINDOW links AS (PARTITION BY chains.run_id, chains.chain)
QUALIFY count(*) OVER links > 1 OR NOT chains.is_whole
