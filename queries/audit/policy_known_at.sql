-- Title: The policy at a time as its decider knew it, beside the true one
-- Paper: eq:policy, sec:evaluation:baselines
-- Grain: one row per run, decider, robot and scope of which the decider had been told by then
-- Key: run_id, known_by, robot, scope
-- Units: learned_us, as_of_us microseconds of run time; at seconds, by default after the end of every run
-- NULL: never; a decider without a row had not been told, or reads the policy itself (an FSAR robot its own)
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

known AS (
    SELECT
        run_id, known_by, robot, scope,
        arg_max(outcome, seq) AS known_outcome,
        arg_max(learned_us, seq) AS learned_us,
        arg_max(as_of_us, seq) AS as_of_us
    FROM told
    WHERE $run IN ('all', run_id) AND $robot IN ('all', robot) AND learned_us <= $at_us::BIGINT
    GROUP BY run_id, known_by, robot, scope
),

judged AS (
    SELECT
        known.run_id, known.known_by, known.robot, known.scope, known.known_outcome, known.learned_us, known.as_of_us,
        CASE
            WHEN bool_or(windows.outcome = 'deny') THEN 'deny'
            WHEN bool_or(windows.outcome = 'review') THEN 'review'
            ELSE 'allow'
        END AS true_outcome
    FROM known
    LEFT JOIN policy_windows AS windows
        ON
            known.run_id = windows.run_id AND known.robot = windows.robot AND known.scope = windows.scope
            AND windows.window_name IS NOT NULL AND windows.opened_us <= $at_us::BIGINT
            AND (windows.closed_us IS NULL OR windows.closed_us > $at_us::BIGINT)
    GROUP BY ALL
)

SELECT
    run_id, known_by, robot, scope, known_outcome, learned_us, as_of_us, true_outcome,
    known_outcome <> true_outcome AS is_wrong
FROM judged
