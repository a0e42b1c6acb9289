-- Title: Chains of delegations, link by link: how each executor judged its own link, and whether the chain is
--   well-formed
-- Paper: eq:nontransitive
-- Grain: one row per request that was asked in the service of another, or served by one, within each chain that it
--   belongs to
-- Key: run_id, chain, action_id
-- Units: link number of the link from 1; asked_us microseconds of run time
-- NULL: verdict, conjunct, trust while nobody has judged the link; conjunct unless denied; is_well_formed when a link
--   is not judged in a run that does not observe request; end_scope when the link's executor had set no trust in the
--   chain's first requester by then
-- Example: fsar-ledger query audit/delegation_chains LEDGER --param run=RUN
--   answers link 1 robot/A1 to robot/B1 (task, admitted), link 2 robot/B1 to robot/C1 (session, admitted): well-formed;
--   robot/C1 has none for robot/A1
-- Parameters: run: run = all, action: action = all
WITH RECURSIVE chains AS (
    SELECT run_id, seq, time_us, action_id AS chain, action_id, requested_by AS first_requester, 1 AS link
    FROM request_issued
    WHERE parent IS NULL AND action_id IS NOT NULL AND $run IN ('all', run_id) AND $action IN ('all', action_id)
    UNION ALL
    SELECT
        asked.run_id, asked.seq, asked.time_us, chains.chain, asked.action_id, chains.first_requester,
        chains.link + 1 AS link
    FROM chains
    -- A request comes after the one that it serves; a forged record that says otherwise is no link.
    INNER JOIN request_issued AS asked
        ON chains.run_id = asked.run_id AND chains.action_id = asked.parent AND chains.seq < asked.seq
),

judged AS (
    SELECT
        run_id,
        asked_seq AS seq,
        arg_max(verdict, seq) AS verdict,
        arg_max(conjunct, seq) AS conjunct,
        arg_max(trust, seq) AS trust
    FROM evaluations
    GROUP BY run_id, asked_seq
),

ends AS (
    SELECT
        chains.run_id, chains.chain, chains.seq,
        arg_max(trust.scope, trust.precedence) AS end_scope
    FROM chains
    INNER JOIN request_issued AS asked ON chains.run_id = asked.run_id AND chains.seq = asked.seq
    INNER JOIN trust_parties AS own
        ON chains.run_id = own.run_id AND asked.executed_by = own.robot AND own.is_trusting AND chains.seq > own.seq
    INNER JOIN trust_parties AS peers
        ON
            own.run_id = peers.run_id AND own.seq = peers.seq AND chains.first_requester = peers.robot
            AND NOT peers.is_trusting
    INNER JOIN trust_precedence AS trust ON own.run_id = trust.run_id AND own.seq = trust.seq
    WHERE
        coalesce(asked.capability = trust.capability, trust.capability IS NULL)
        AND coalesce(asked.task_id = trust.context, trust.context IS NULL)
    GROUP BY chains.run_id, chains.chain, chains.seq
)

SELECT
    chains.run_id, chains.chain, chains.link, chains.action_id,
    chains.time_us AS asked_us,
    asked.requested_by, asked.executed_by, asked.capability, judged.trust, judged.verdict, judged.conjunct,
    CASE
        WHEN bool_or(judged.verdict <> 'admitted') OVER links THEN FALSE
        WHEN count(judged.verdict) OVER links = count(*) OVER links THEN TRUE
        WHEN list_contains(runs.observes, 'request') THEN FALSE
    END AS is_well_formed,
    ends.end_scope
FROM chains
INNER JOIN request_issued AS asked ON chains.run_id = asked.run_id AND chains.seq = asked.seq
INNER JOIN runs ON chains.run_id = runs.run_id
LEFT JOIN judged ON chains.run_id = judged.run_id AND chains.seq = judged.seq
LEFT JOIN ends ON chains.run_id = ends.run_id AND chains.chain = ends.chain AND chains.seq = ends.seq
WINDOW links AS (PARTITION BY chains.run_id, chains.chain)
QUALIFY count(*) OVER links > 1
