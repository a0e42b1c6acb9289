-- Title: What shows governed delegation: trust where it was needed, policies that were composed, a registry that hides
-- Paper: tab:baseline_context, eq:trust, eq:policy, sec:architecture:registry
-- Grain: one row per made_alike (as in run_groups) and part
-- Key: made_alike, part
-- Units: numerator, denominator counts
-- NULL: never; no row for a part that nothing in the ledger could show, and none of runs that do not observe what it
--   rests on
-- Example: fsar-ledger query tables/evidence_of_governance LEDGER
-- Stored: in one plan with the other two, DuckDB plans longer than it computes
WITH outsiders AS (
    SELECT
        attempts.run_id,
        count(done.seq) = 0 AS is_refused
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
    -- The registry, or whoever matches candidates, was asked for the capability for this task, and the executor was no
    -- peer remembered from a meeting.
    SELECT
        done.run_id,
        count(asked.seq) > count(met.seq) AS is_found
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
    SELECT
        { 'run_id': run_id, 'part': 'untrusted delegations that went through trusted links', 'holds': is_chained }
            AS fact
    FROM delegated_trust
    WHERE NOT is_direct
    UNION ALL
    SELECT
        {
            'run_id': run_id, 'part': unnest(['outsiders refused', 'hidden capabilities kept from outsiders']),
            'holds': is_refused
        } AS fact
    FROM outsiders
    UNION ALL
    SELECT
        {
            'run_id': said.run_id, 'part': 'decisions on the executor''s policy',
            'holds': said.decided_by[:6] IN ('robot/', 'agent/') OR count(copies.seq) > 0
        } AS fact
    FROM request_events AS said
    LEFT JOIN copy_synced AS copies ON said.run_id = copies.run_id AND said.seq > copies.seq
    WHERE said.type IN ('RequestAdmitted.v1', 'CommandIssued.v1')
    GROUP BY said.run_id, said.seq, said.decided_by
    UNION ALL
    SELECT { 'run_id': run_id, 'part': 'the requester''s policy heeded', 'holds': is_heeded } AS fact
    FROM policy_decisions
    WHERE is_against_requester
    UNION ALL
    SELECT { 'run_id': run_id, 'part': 'the fleet''s rule heeded', 'holds': is_heeded } AS fact
    FROM policy_decisions
    WHERE is_against_fleet
    UNION ALL
    SELECT { 'run_id': run_id, 'part': 'delegations found beyond the peers that were met', 'holds': is_found } AS fact
    FROM found
)

SELECT
    runs.made_alike,
    counted.fact.part,
    count(*) FILTER (coalesce(counted.fact.holds, FALSE)) AS numerator,
    count(*) AS denominator
FROM run_groups AS runs
INNER JOIN counted ON runs.run_id = counted.fact.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND counted.fact.part = hidden.judge
WHERE hidden.run_id IS NULL
GROUP BY ALL
