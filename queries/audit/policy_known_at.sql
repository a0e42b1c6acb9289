-- Title: The policy at a time as its decider knew it, beside the true one
-- Paper: eq:policy, sec:evaluation:baselines
-- Grain: one row per run, robot, scope and decider that had been told of it by then, or with the reason why none
-- Key: run_id, known_by?, robot, scope
-- Units: learned_us, as_of_us microseconds of run time; at seconds, by default the end; true_outcome by the windows
-- NULL: the known policy and the comparison when no decider had been told; why_unknown when one had; true_outcome,
--   is_wrong when no window on record (with its end) asks for review or denies and not all policy is observed
-- Example: fsar-ledger query audit/policy_known_at LEDGER --param run=RUN --param robot=robot/D1 --param at=31.2
--   answers the coordinator takes the fleet's rule to allow, as of 25.305 s; truly it denies, so it is wrong
-- Parameters: run: run = all, robot: robot = all, at: time = end
WITH asked AS (
    SELECT
        subjects.run_id, subjects.robot, subjects.scope, runs.architecture, runs.observes,
        list_contains(runs.observes, 'policy') OR list_contains(runs.records, 'PolicyWindowClosed') AS tells_ends
    FROM policy_subjects AS subjects LEFT JOIN run_started AS runs ON subjects.run_id = runs.run_id
    WHERE $run IN ('all', subjects.run_id) AND $robot IN ('all', subjects.robot)
),

latest AS (
    SELECT
        run_id, known_by, robot, scope,
        max_by(outcome, seq) AS known_outcome, max_by(learned_us, seq) AS learned_us, max_by(as_of_us, seq) AS as_of_us
    FROM policies_told
    WHERE learned_us <= $at_us::BIGINT
    GROUP BY run_id, known_by, robot, scope
),

later AS (
    SELECT run_id, robot, scope, min(learned_us) AS first_us
    FROM policies_told
    GROUP BY ALL
),

known AS (
    SELECT
        asked.run_id, latest.known_by, asked.robot, asked.scope, latest.known_outcome, latest.learned_us,
        latest.as_of_us, asked.observes, asked.tells_ends,
        CASE
            WHEN latest.known_by IS NOT NULL THEN NULL
            WHEN later.first_us IS NOT NULL
                THEN 'nobody had been told by then; the first is told at ' || later.first_us / 1000000 || ' s'
            WHEN NOT coalesce(list_contains(asked.observes, 'knowledge'), FALSE)
                THEN 'not observable: the run does not observe knowledge, that is what deciders are told'
            WHEN asked.architecture = 'fsar' AND asked.scope = 'local'
                THEN 'fsar keeps no copies: each robot reads its own policy'
            ELSE 'nobody is told of it in this run'
        END AS why_unknown
    FROM asked
    LEFT JOIN latest ON asked.run_id = latest.run_id AND asked.robot = latest.robot AND asked.scope = latest.scope
    LEFT JOIN later ON asked.run_id = later.run_id AND asked.robot = later.robot AND asked.scope = later.scope
),

judged AS (
    SELECT
        known.run_id, known.known_by, known.robot, known.scope, known.known_outcome, known.learned_us, known.as_of_us,
        known.why_unknown,
        CASE
            WHEN bool_or(windows.outcome = 'deny') THEN 'deny'
            WHEN bool_or(windows.outcome = 'review') THEN 'review'
            WHEN bool_and(list_contains(known.observes, 'policy') AND past.run_id IS NULL) THEN 'allow'
        END AS true_outcome
    FROM known
    LEFT JOIN policy_windows AS windows
        ON
            known.run_id = windows.run_id AND known.robot = windows.robot AND known.scope = windows.scope
            AND windows.window_name IS NOT NULL
            AND $at_us::BIGINT BETWEEN windows.opened_us
            AND coalesce(windows.closed_us - 1, if(known.tells_ends, $at_us::BIGINT, NULL))
    LEFT JOIN begun_before AS past
        ON
            known.run_id = past.run_id AND known.robot = past.robot AND known.scope = past.scope
            AND past.what = 'window' AND past.until_us > $at_us::BIGINT
    GROUP BY ALL
)

SELECT
    run_id, known_by, robot, scope, known_outcome, learned_us, as_of_us,
    if(known_by IS NULL, NULL, true_outcome) AS true_outcome,
    known_outcome <> true_outcome AS is_wrong, why_unknown
FROM judged
