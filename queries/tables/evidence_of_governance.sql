-- Title: Evidence of governed delegation: trust where it was needed, composed policies, a registry that hides
-- Paper: tab:baseline_context, eq:trust, eq:policy, sec:architecture:registry
-- Grain: one row per run and part
-- Key: run_id, part
-- Units: numerator, denominator counts
-- NULL: never; no row for a part that nothing in the run could show, or that it does not observe
-- Example: fsar-ledger query tables/evidence_of_governance LEDGER
-- Partial: the rows of a run do not depend on other runs
-- Stored: together with the other two, it takes DuckDB longer to plan than to compute
WITH outsiders AS (
    SELECT attempts.run_id, count(done.seq) = 0 AS is_refused
    FROM outsider_request_injected AS attempts
    LEFT JOIN execution_started AS done ON attempts.run_id = done.run_id AND attempts.task_id = done.task_id
    GROUP BY attempts.run_id, attempts.seq
),

asked AS (
    SELECT run_id, seq, time_us, task_id, capability
    FROM registry_queried
    UNION ALL
    SELECT run_id, seq, time_us, task_id, capability
    FROM candidate_matched
),

found AS (
    -- The registry, or another matcher of candidates, was queried for the capability for this task, and the executor
    -- was no peer remembered from a meeting.
    SELECT done.run_id, count(asked.seq) > count(met.seq) AS is_found
    FROM executions AS done
    LEFT JOIN asked
        ON
            done.run_id = asked.run_id AND done.task_id = asked.task_id AND done.capability = asked.capability
            AND done.seq > asked.seq
    LEFT JOIN peer_remembered AS met
        ON
            asked.run_id = met.run_id AND done.on_behalf_of = met.robot AND done.robot = met.peer
            AND asked.seq > met.seq AND asked.time_us <= met.until_us
    WHERE done.robot <> done.on_behalf_of
    GROUP BY done.run_id, done.seq
),

counted AS (
    SELECT run_id, 'untrusted delegations that went through trusted links' AS part, is_chained AS holds
    FROM delegated_trust
    WHERE NOT is_direct
    UNION ALL
    SELECT run_id, unnest(['outsiders refused', 'hidden capabilities kept from outsiders']) AS part, is_refused AS holds
    FROM outsiders
    UNION ALL
    SELECT
        said.run_id, 'decisions on the executor''s policy' AS part,
        said.decided_by[:6] IN ('robot/', 'agent/') OR count(copies.seq) > 0 AS holds
    FROM request_events AS said
    LEFT JOIN copy_synced AS copies ON said.run_id = copies.run_id AND said.seq > copies.seq
    WHERE said.type IN ('RequestAdmitted.v1', 'CommandIssued.v1')
    GROUP BY said.run_id, said.seq, said.decided_by
    UNION ALL
    SELECT run_id, 'the requester''s policy heeded' AS part, is_heeded AS holds
    FROM policy_decisions
    WHERE is_against_requester
    UNION ALL
    SELECT run_id, 'the fleet''s rule heeded' AS part, is_heeded AS holds
    FROM policy_decisions
    WHERE is_against_fleet
    UNION ALL
    SELECT run_id, 'delegations found beyond the peers that were met' AS part, is_found AS holds
    FROM found
)

SELECT
    counted.run_id, counted.part,
    count(*) FILTER (coalesce(counted.holds, FALSE)) AS numerator,
    count(*) AS denominator
FROM counted
LEFT JOIN unobservable AS hidden ON counted.run_id = hidden.run_id AND counted.part = hidden.judge
WHERE hidden.run_id IS NULL
GROUP BY ALL
