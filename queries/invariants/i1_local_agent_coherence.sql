-- Title: I1 broken: a robot acts as more than one fleet-visible principal, or as one that never joined or has departed
-- Paper: sec:model:invariants (I1), eq:runtime
-- Grain: one row per event and principal that is no joined robot, no supervisor, no federation service and no
--   coordinator; per joining of a robot that is in the fleet; and per act of a robot that had departed, or claim under
--   its old number
-- Key: run_id, seq, found
-- Units: time_us microseconds of run time
-- NULL: action_id when the event is not tied to an action
-- Example: fsar-ledger query invariants/i1_local_agent_coherence LEDGER
WITH members AS (
    SELECT
        joined.run_id, joined.robot, joined.supervisor, joined.seq, joined.time_us,
        lag(joined.seq) OVER (PARTITION BY joined.run_id, joined.robot ORDER BY joined.seq) AS joined_before,
        departed.seq AS departed_seq,
        returned.seq AS returned_seq
    FROM robot_joined AS joined
    ASOF LEFT JOIN robot_departed AS departed
        ON joined.run_id = departed.run_id AND joined.robot = departed.robot AND joined.seq > departed.seq
    ASOF LEFT JOIN robot_returned AS returned
        ON joined.run_id = returned.run_id AND joined.robot = returned.robot AND joined.seq > returned.seq
),

known AS (
    SELECT run_id, robot AS principal FROM members
    UNION
    SELECT run_id, supervisor AS principal FROM members
    UNION
    SELECT
        run_id,
        unnest([
            'supervisor/fleet', 'service/registry', 'service/coordination', 'service/recovery', 'service/policy',
            'service/trust', 'coordinator'
        ]) AS principal
    FROM runs
),

named AS (
    SELECT
        run_id, seq, time_us, type, action_id,
        -- Each principal once, without NULL.
        unnest(list_distinct(list_concat(
            [decided_by, requested_by, executed_by, executor, supervised_by, claimant, sender, receiver],
            coalesce(path, [])
        ))) AS principal
    FROM naming_events
    WHERE names_somebody
)

SELECT
    named.run_id, named.seq, named.time_us, named.type, named.action_id,
    -- It need not have acted: the event may only be a request to it.
    named.principal || ' is named, and is neither a robot of the fleet nor one of its supervisors or services' AS found
FROM named
LEFT JOIN known ON named.run_id = known.run_id AND named.principal = known.principal
LEFT JOIN run_started AS runs ON named.run_id = runs.run_id
WHERE
    known.principal IS NULL
    -- A supervisor is not judged where the source does not record whose it is.
    AND (
        NOT starts_with(named.principal, 'supervisor/') OR runs.records IS NULL OR list_contains(runs.observes, 'fleet')
        OR list_contains(runs.records, 'RobotJoined.supervisor')
    )
UNION ALL
SELECT
    run_id, seq, time_us, 'RobotJoined.v1' AS type, NULL AS action_id,
    robot || ' joins although it is in the fleet' AS found
FROM members
-- Where a source does not record departures, it may have departed.
SEMI JOIN run_started AS runs
    ON members.run_id = runs.run_id AND list_has_any(list_cat(runs.observes, runs.records), ['fleet', 'RobotDeparted'])
WHERE greatest(joined_before, returned_seq) > coalesce(departed_seq, -1)
UNION ALL
SELECT
    run_id, seq, time_us, type, action_id,
    robot || if(
        is_away, ' acts after it departed',
        ' claims authority under fencing number ' || fence || ' after ' || departures || ' departures'
    ) AS found
FROM acts_of_departed
