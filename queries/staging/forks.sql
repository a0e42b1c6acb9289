-- Title: Forks: which run each repeats, how far, and what differs
-- Paper: sec:evaluation:significance
-- Grain: one row per fork
-- Key: run_id
-- Units: forked_from_root hex, the root of the ledger from which it forks; forked_from_seq the last event that both
--   have in common, apart from event 0; diverges whether they differ in more than the fork's own inputs and their
--   refusals, as `whatif` counts; parted_s seconds of run time at the fork's first other event, or, if it has ended,
--   the base's; changes as in docs/replay.md
-- NULL: base_run_id and diverges where this ledger does not hold the base; parted_s there and where they do not diverge
-- Example: fsar-ledger query staging/forks LEDGER
WITH extents AS (
    SELECT
        run_id, max(seq) AS last_seq, max(time_us) AS ended_us,
        list(DISTINCT task_id) || list(DISTINCT robot) FILTER (type = 'RobotJoined.v1')
        || list(DISTINCT supervisor) FILTER (type = 'RobotJoined.v1') AS names
    FROM events
    GROUP BY run_id
),

found AS (
    SELECT
        started.run_id, started.forked_from_root, started.forked_from_run, started.forked_from_seq, started.changes,
        bases.run_id AS base_run_id, bases.ended_us, own.names || bases.names AS names,
        bases.last_seq <> started.forked_from_seq OR own.last_seq <> started.forked_from_seq AS differs
    FROM run_started AS started
    INNER JOIN extents AS own ON started.run_id = own.run_id
    LEFT JOIN extents AS bases ON started.forked_from_run = bases.run_id
    WHERE started.changes IS NOT NULL
),

refused AS (
    -- Commands that the fork rejects and its base does not: each rejection, with the outside command that it answers.
    SELECT
        rejected.run_id,
        unnest(if(given.seq IS NULL, [rejected.seq], [given.seq, rejected.seq])) AS seq
    FROM found
    INNER JOIN command_rejected AS rejected ON found.run_id = rejected.run_id AND found.forked_from_seq < rejected.seq
    ANTI JOIN command_rejected AS known
        ON
            found.base_run_id = known.run_id AND rejected.command = known.command AND rejected.subject = known.subject
            AND rejected.reason = known.reason
    LEFT JOIN command_given AS given ON rejected.run_id = given.run_id AND rejected.caused_by = given.seq
    UNION
    -- Inputs about no member of the fleet, about a task that never arrives, or given after the base has ended.
    SELECT given.run_id, given.seq
    FROM found
    INNER JOIN events AS given
        ON found.run_id = given.run_id AND found.forked_from_seq < given.seq AND coalesce(given.caused_by, 0) = 0
    WHERE
        given.time_us > found.ended_us
        OR NOT (
            list_contains(found.names, given.robot) AND list_contains(found.names, given.peer)
            AND list_contains(found.names, given.supervisor) AND list_contains(found.names, given.context)
        )
),

rests AS (
    -- Without these and their effects, the balance of two runs with the same events at the same times is 0.
    SELECT
        found.run_id,
        sum(
            if(one.run_id = found.run_id, 1, -1)
            * hash(json_merge_patch(to_json(one), '{"run_id": null, "seq": null, "caused_by": null}'))::HUGEINT
        ) FILTER (WHERE taken.seq IS NULL) AS balance
    FROM found
    SEMI JOIN refused ON found.run_id = refused.run_id
    INNER JOIN events AS one ON one.run_id IN (found.run_id, found.base_run_id) AND found.forked_from_seq < one.seq
    LEFT JOIN refused AS taken ON one.run_id = taken.run_id AND taken.seq IN (one.seq, one.caused_by)
    GROUP BY found.run_id
)

SELECT
    found.run_id, found.forked_from_root, found.forked_from_run, found.forked_from_seq, found.changes,
    found.base_run_id,
    found.differs AND (rests.run_id IS NULL OR coalesce(rests.balance, 0) <> 0) AS diverges,
    CASE WHEN diverges THEN coalesce(firsts.time_us, seconds.time_us) / 1e6 END AS parted_s
FROM found
LEFT JOIN rests ON found.run_id = rests.run_id
LEFT JOIN events AS firsts ON found.run_id = firsts.run_id AND found.forked_from_seq + 1 = firsts.seq
LEFT JOIN events AS seconds ON found.base_run_id = seconds.run_id AND found.forked_from_seq + 1 = seconds.seq
