-- Title: Verdicts on a moment or a task of a run, with the events that made each
-- Paper: sec:evaluation:metrics
-- Grain: one row per start against policy (violation), authority conflict (conflict), task that is not completed within
--   its budget (late), and record that is not attributable (unattributed)
-- Key: run_id, verdict, seq, action_id, about
-- Units: time_us microseconds of run time; seq, made_by positions in the run
-- NULL: action_id for a motion, a task, and a record that names none
-- Example: fsar-ledger query facts/verdict_events LEDGER
-- Made by: the windows and rules that were in force, and the start; the claims that overlap; the arrival of the task,
-- what held it up, and its end; the record.
WITH violations AS (
    SELECT
        run_id,
        'violation' AS verdict,
        seq,
        started_us AS time_us,
        action_id,
        robot AS about,
        concat(
            robot, ' starts although the outcome is ', outcome,
            if(outcome = 'review', ', and nobody has approved', '')
        ) AS found,
        list_append(under_seqs, seq) AS made_by
    FROM governed_starts
    WHERE is_violation
),

claimed AS (
    SELECT
        conflicts.run_id, conflicts.action_id, conflicts.dimension, conflicts.began_us,
        one.claimant AS one_claimant,
        other.claimant AS other_claimant,
        unnest([one.seq, other.seq]) AS seq
    FROM conflicts
    INNER JOIN held_claims AS one
        ON
            conflicts.run_id = one.run_id AND conflicts.action_id = one.action_id
            AND conflicts.dimension = one.dimension
    INNER JOIN held_claims AS other
        ON
            one.run_id = other.run_id AND one.action_id = other.action_id AND one.dimension = other.dimension
            AND one.claimant < other.claimant
            AND one.began_us < other.ended_us AND one.ended_us > other.began_us
),

conflicting AS (
    SELECT
        claimed.run_id,
        'conflict' AS verdict,
        max(claimed.seq) FILTER (claims.began_us = claimed.began_us) AS seq,
        claimed.began_us AS time_us,
        claimed.action_id,
        claimed.dimension AS about,
        concat(
            string_agg(DISTINCT claims.claimant, ' and ' ORDER BY claims.claimant), ' hold ', claimed.dimension,
            ' at once'
        ) AS found,
        list(DISTINCT claimed.seq ORDER BY claimed.seq) AS made_by
    FROM claimed
    INNER JOIN held_claims AS claims ON claimed.run_id = claims.run_id AND claimed.seq = claims.seq
    GROUP BY claimed.run_id, claimed.action_id, claimed.dimension, claimed.began_us
),

ends AS (
    SELECT
        run_id, task_id,
        min(seq) AS seq,
        min(time_us) AS ended_us,
        TRUE AS is_completed
    FROM task_completed
    GROUP BY run_id, task_id
    UNION ALL
    SELECT
        run_id, task_id,
        min(seq) AS seq,
        min(time_us) AS ended_us,
        FALSE AS is_completed
    FROM task_abandoned
    GROUP BY run_id, task_id
),

held_up AS (
    SELECT run_id, task_id, seq FROM request_denied
    UNION ALL
    SELECT run_id, task_id, seq FROM request_unanswered
    UNION ALL
    SELECT run_id, task_id, seq FROM execution_held
    UNION ALL
    SELECT run_id, task_id, seq FROM execution_failed
),

late AS (
    SELECT
        arrived.run_id,
        'late' AS verdict,
        coalesce(any_value(ends.seq), arrived.seq) AS seq,
        coalesce(any_value(ends.ended_us), arrived.time_us) AS time_us,
        NULL::VARCHAR AS action_id,
        arrived.task_id AS about,
        concat(
            arrived.task_id, ' is due at ', printf('%.3f s', (arrived.time_us + arrived.budget_us) / 1e6), ', and ',
            CASE any_value(ends.is_completed)
                WHEN TRUE THEN printf('completed at %.3f s', any_value(ends.ended_us) / 1e6)
                WHEN FALSE THEN printf('given up at %.3f s', any_value(ends.ended_us) / 1e6)
                ELSE 'does not end'
            END
        ) AS found,
        list_sort(
            list_distinct(list_concat([arrived.seq, any_value(ends.seq)], list(held_up.seq)))
        ) AS made_by
    FROM task_arrived AS arrived
    LEFT JOIN ends ON arrived.run_id = ends.run_id AND arrived.task_id = ends.task_id
    LEFT JOIN held_up ON arrived.run_id = held_up.run_id AND arrived.task_id = held_up.task_id
    WHERE NOT coalesce(ends.is_completed AND ends.ended_us - arrived.time_us <= arrived.budget_us, FALSE)
    GROUP BY arrived.run_id, arrived.seq, arrived.time_us, arrived.budget_us, arrived.task_id
),

unattributed AS (
    SELECT
        run_id,
        'unattributed' AS verdict,
        seq, time_us, action_id,
        record_kind AS about,
        concat(
            record_kind, ' without ',
            concat_ws(
                ', ',
                CASE WHEN NOT has_origin THEN 'requester' END,
                CASE WHEN NOT has_executor THEN 'executor' END,
                CASE WHEN NOT has_supervisor THEN 'supervisor' END
            )
        ) AS found,
        [seq] AS made_by
    FROM coordination_events
    WHERE NOT is_attributable
)

SELECT run_id, verdict, seq, time_us, action_id, about, found, made_by FROM violations
UNION ALL
SELECT run_id, verdict, seq, time_us, action_id, about, found, made_by FROM conflicting
UNION ALL
SELECT run_id, verdict, seq, time_us, action_id, about, found, made_by FROM late
UNION ALL
SELECT run_id, verdict, seq, time_us, action_id, about, found, made_by FROM unattributed
