-- Title: The policy at a time as its decider knew it, beside the true one
-- Paper: eq:policy, sec:evaluation:baselines
-- Grain: one row per run, robot, scope and decider that had been told of it by then; one for a robot and scope of
--   which nobody had, which says why
-- Key: run_id, known_by?, robot, scope
-- Units: learned_us, as_of_us microseconds of run time; true_outcome that of the windows, of which deciders are told;
--   at seconds, by default after the end of every run
-- NULL: known_by, known_outcome, learned_us, as_of_us, true_outcome, is_wrong when nobody had been told; why_unknown
--   when somebody had; true_outcome, is_wrong also when no window on record asks for review or denies and the run does
--   not observe policy. A decider without a row had not been told, or reads the policy itself
-- Example: fsar-ledger query audit/policy_known_at LEDGER --param run=RUN --param robot=robot/D1 --param at=31.2
--   answers the coordinator takes the fleet's rule to allow, as of 25.305 s; truly it denies, so it is wrong
-- Parameters: run: run = all, robot: robot = all, at: time = end
WITH copies AS (
    -- A copy covers every robot; one that it does not name is allowed.
    SELECT
        copies.run_id, copies.seq,
        copies.time_us AS learned_us,
        'coordinator' AS known_by,
        members.robot, scopes.scope,
        CASE
            WHEN list_contains(if(scopes.scope = 'local', copies.local_deny, copies.fleet_deny), members.robot)
                THEN 'deny'
            WHEN list_contains(if(scopes.scope = 'local', copies.local_review, copies.fleet_review), members.robot)
                THEN 'review'
            ELSE 'allow'
        END AS outcome,
        copies.time_us AS as_of_us
    FROM copy_synced AS copies
    INNER JOIN fleet_members AS members ON copies.run_id = members.run_id
    CROSS JOIN (VALUES ('local'), ('fleet')) AS scopes (scope)
),

told AS (
    -- Deciders are told of windows; rules are known to all at once, and audit/policy_at has them.
    SELECT
        run_id, seq,
        time_us AS learned_us,
        CASE type WHEN 'FleetRuleLearned.v1' THEN robot ELSE 'agent/' || robot[7:] || '/planning' END AS known_by,
        robot,
        CASE type WHEN 'FleetRuleLearned.v1' THEN 'fleet' ELSE 'local' END AS scope,
        outcome,
        coalesce(as_of_us, time_us) AS as_of_us
    FROM knowledge_events
    WHERE type IN ('FleetRuleLearned.v1', 'SnapshotTaken.v1')
    UNION ALL
    SELECT *
    FROM copies
),

asked AS (
    SELECT
        members.run_id, members.robot, scopes.scope, runs.architecture,
        coalesce(list_contains(runs.observes, 'knowledge'), FALSE) AS is_told_observed,
        coalesce(list_contains(runs.observes, 'policy'), FALSE) AS is_observed
    FROM fleet_members AS members
    INNER JOIN runs ON members.run_id = runs.run_id
    CROSS JOIN (VALUES ('local'), ('fleet')) AS scopes (scope)
    WHERE $run IN ('all', members.run_id) AND $robot IN ('all', members.robot)
),

latest AS (
    SELECT
        run_id, known_by, robot, scope,
        arg_max(outcome, seq) AS known_outcome,
        arg_max(learned_us, seq) AS learned_us,
        arg_max(as_of_us, seq) AS as_of_us
    FROM told
    WHERE learned_us <= $at_us::BIGINT
    GROUP BY run_id, known_by, robot, scope
),

later AS (
    SELECT
        run_id, robot, scope,
        min(learned_us) AS first_us
    FROM told
    GROUP BY run_id, robot, scope
),

known AS (
    SELECT
        asked.run_id, latest.known_by, asked.robot, asked.scope, latest.known_outcome, latest.learned_us,
        latest.as_of_us, asked.is_observed,
        CASE
            WHEN latest.known_by IS NOT NULL THEN NULL
            WHEN later.first_us IS NOT NULL
                THEN 'nobody had been told by then; the first is told at ' || later.first_us / 1000000 || ' s'
            WHEN NOT asked.is_told_observed
                THEN 'not observable: the run does not observe knowledge, that is what deciders are told'
            WHEN asked.architecture = 'fsar' AND asked.scope = 'local'
                THEN 'fsar keeps no copies: each robot reads its own policy'
            ELSE 'nobody is told of it in this run'
        END AS why_unknown
    FROM asked
    LEFT JOIN latest
        ON asked.run_id = latest.run_id AND asked.robot = latest.robot AND asked.scope = latest.scope
    LEFT JOIN later ON asked.run_id = later.run_id AND asked.robot = later.robot AND asked.scope = later.scope
),

judged AS (
    SELECT
        known.run_id, known.known_by, known.robot, known.scope, known.known_outcome, known.learned_us, known.as_of_us,
        CASE
            WHEN known.known_by IS NULL THEN NULL
            WHEN bool_or(windows.outcome = 'deny') THEN 'deny'
            WHEN bool_or(windows.outcome = 'review') THEN 'review'
            WHEN known.is_observed THEN 'allow'
        END AS true_outcome,
        known.why_unknown
    FROM known
    LEFT JOIN policy_windows AS windows
        ON
            known.run_id = windows.run_id AND known.robot = windows.robot AND known.scope = windows.scope
            AND windows."window" IS NOT NULL AND windows.opened_us <= $at_us::BIGINT
            AND (windows.closed_us IS NULL OR windows.closed_us > $at_us::BIGINT)
    GROUP BY
        known.run_id, known.known_by, known.robot, known.scope, known.known_outcome, known.learned_us, known.as_of_us,
        known.is_observed, known.why_unknown
)

SELECT
    run_id, known_by, robot, scope, known_outcome, learned_us, as_of_us, true_outcome,
    known_outcome <> true_outcome AS is_wrong,
    why_unknown
FROM judged
