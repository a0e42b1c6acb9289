-- Title: Case 3, run by run: conflicts over the capability that two tasks want at once, and calls to H_F to order them
-- Paper: sec:evaluation:qualitative (case 3)
-- Grain: one row per claim and run of the scenario in which steps of two tasks that need door.open.secure are open at
--   the same time
-- Key: run_id, claim
-- Units: counted conflicts, or 1 and 0 for the claim on H_F; seq the step that came second, evidence the claims that
--   made the conflicts, and for H_F the calls: positions in the run
-- NULL: never; evidence is empty where nothing is counted
-- Example: fsar-ledger query cases/case_3_evidence LEDGER
-- A step is open until its task moves to another or ends. Conflicts that do not involve the other task count, too
-- (R46).
WITH turns AS (
    SELECT
        events.run_id, events.action_id, events.capability, events.seq,
        coalesce(
            lead(events.seq) OVER (PARTITION BY events.run_id, events.task_id ORDER BY events.seq), 9223372036854775807
        ) AS until_seq
    FROM task_events AS events
    INNER JOIN runs ON events.run_id = runs.run_id
    WHERE runs.scenario = 'fleet-contention' AND events.type IN ('StepBegan.v1', 'TaskCompleted.v1', 'TaskAbandoned.v1')
),

wanted AS (
    SELECT *
    FROM turns
    WHERE capability = 'door.open.secure'
),

contended AS (
    -- A task has one open step at a time, so these belong to two tasks.
    SELECT
        later.run_id,
        min(later.seq) AS seq
    FROM wanted AS earlier
    INNER JOIN wanted AS later
        ON earlier.run_id = later.run_id AND earlier.seq < later.seq AND earlier.until_seq > later.seq
    GROUP BY later.run_id
),

found AS (
    SELECT
        conflicts.run_id, conflicts.dimension,
        min(claims.seq) AS seq
    FROM wanted
    INNER JOIN conflicts ON wanted.run_id = conflicts.run_id AND wanted.action_id = conflicts.action_id
    INNER JOIN claims
        ON
            conflicts.run_id = claims.run_id AND conflicts.action_id = claims.action_id
            AND conflicts.dimension = claims.dimension AND conflicts.began_us = claims.began_us
    GROUP BY conflicts.run_id, conflicts.action_id, conflicts.dimension
),

sorted AS (
    -- A call to order two requests is about execution authority.
    SELECT
        run_id,
        unnest(if(dimension = 'execution', ['conflicts', 'conflicts over execution'], ['conflicts'])) AS claim,
        seq
    FROM found
    UNION ALL
    SELECT
        calls.run_id,
        'conflict for H_F' AS claim,
        unnest([calls.seq, min(found.seq)]) AS seq
    FROM supervisor_called AS calls
    INNER JOIN wanted ON calls.run_id = wanted.run_id AND calls.action_id = wanted.action_id
    INNER JOIN found ON calls.run_id = found.run_id AND calls.seq > found.seq AND found.dimension = 'execution'
    WHERE calls.supervisor = 'supervisor/fleet' AND calls.purpose = 'ordering'
    GROUP BY calls.run_id, calls.seq
)

SELECT
    contended.run_id, claims.claim, contended.seq,
    CASE claims.claim WHEN 'conflict for H_F' THEN (count(sorted.seq) > 0)::BIGINT ELSE count(sorted.seq) END
        AS counted,
    list_sort(coalesce(list(DISTINCT sorted.seq) FILTER (sorted.seq IS NOT NULL), [])) AS evidence
FROM contended
CROSS JOIN (VALUES ('conflicts'), ('conflicts over execution'), ('conflict for H_F')) AS claims (claim)
LEFT JOIN sorted ON contended.run_id = sorted.run_id AND claims.claim = sorted.claim
GROUP BY contended.run_id, claims.claim, contended.seq
