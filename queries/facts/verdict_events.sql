-- Title: Verdicts on a moment or a task of a run, with the events behind each
-- Paper: sec:evaluation:metrics
-- Grain: one row per start against policy (violation), authority conflict (conflict), task not completed within its
--   budget (late), and record that is not attributable (unattributed)
-- Key: run_id, verdict, seq, about
-- Units: time_us microseconds of run time; seq, made_by positions in the run
-- NULL: action_id for a motion, a task, and a record that names none; time_us of a task that never ended and whose due
--   time is not known
-- Example: fsar-ledger query facts/verdict_events LEDGER
-- Behind each: the windows and rules in force, and the start; the overlapping claims; the arrival of the task, what
-- held it up, and its end; the record.
WITH violations AS (
    SELECT
        run_id, seq,
        started_us AS time_us,
        action_id,
        robot AS about,
        concat(
            robot, ' starts although the outcome is ', outcome, if(outcome = 'review', ', and nobody has approved', '')
        ) AS found,
        list_append(under_seqs, seq) AS made_by
    FROM governed_starts
    WHERE is_violation
),

late AS (
    SELECT
        run_id,
        coalesce(ended_seq, arrived_seq) AS seq,
        coalesce(ended_us, due_us) AS time_us,
        task_id AS about,
        concat(
            task_id, coalesce(printf(' is due at %.3f s, and ', due_us / 1e6), ' '),
            CASE is_completed WHEN TRUE THEN 'completed' WHEN FALSE THEN 'given up' ELSE 'never ended' END,
            printf(' at %.3f s', ended_us / 1e6)
        ) AS found,
        list_sort(list_distinct(list_concat([arrived_seq], held_up_seqs, [ended_seq]))) AS made_by
    FROM late_tasks
),

unattributed AS (
    SELECT
        run_id, seq, time_us, action_id,
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

SELECT run_id, 'violation' AS verdict, seq, time_us, action_id, about, found, made_by FROM violations
UNION ALL
SELECT
    run_id, 'conflict' AS verdict, seq,
    began_us AS time_us,
    action_id,
    dimension AS about,
    concat(array_to_string(claimants, ' and '), ' hold ', dimension, ' at once') AS found,
    claim_seqs AS made_by
FROM conflicting_claims
UNION ALL
SELECT run_id, 'late' AS verdict, seq, time_us, NULL::VARCHAR AS action_id, about, found, made_by FROM late
UNION ALL
SELECT run_id, 'unattributed' AS verdict, seq, time_us, action_id, about, found, made_by FROM unattributed
