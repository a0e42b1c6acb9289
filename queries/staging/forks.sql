-- Title: Forks: which run each repeats, how far, and what is otherwise
-- Paper: sec:evaluation:significance
-- Grain: one row per fork
-- Key: run_id
-- Units: forked_from_root hex, the root of the ledger from which it forks; forked_from_seq the last event that both
--   have in common but for event 0; parted_s seconds of run time, when the fork first does something else, or, where it
--   has already ended then, the base; changes as in docs/replay.md
-- NULL: base_run_id and diverges where this ledger does not hold the base; parted_s there too, and where they do not
--   part
-- Example: fsar-ledger query staging/forks LEDGER
WITH extents AS (
    SELECT
        run_id,
        max(seq) AS last_seq
    FROM events
    GROUP BY run_id
),

found AS (
    SELECT
        started.run_id, started.forked_from_root, started.forked_from_run, started.forked_from_seq, started.changes,
        bases.run_id AS base_run_id,
        bases.last_seq <> started.forked_from_seq OR own.last_seq <> started.forked_from_seq AS diverges
    FROM run_started AS started
    INNER JOIN extents AS own ON started.run_id = own.run_id
    LEFT JOIN extents AS bases ON started.forked_from_run = bases.run_id
    WHERE started.changes IS NOT NULL
)

SELECT
    found.run_id, found.forked_from_root, found.forked_from_run, found.forked_from_seq, found.changes,
    found.base_run_id, found.diverges,
    CASE WHEN found.diverges THEN coalesce(firsts.time_us, seconds.time_us) / 1e6 END AS parted_s
FROM found
LEFT JOIN events AS firsts ON found.run_id = firsts.run_id AND found.forked_from_seq + 1 = firsts.seq
LEFT JOIN events AS seconds ON found.base_run_id = seconds.run_id AND found.forked_from_seq + 1 = seconds.seq
