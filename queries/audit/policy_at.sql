-- Title: The policy actually in force at a time
-- Paper: eq:policy, app:foundations
-- Grain: one row per run, robot and scope (facts/policy_subjects), capability and context that have a rule of their own
--   in that run, with one for all others; or for the capability and context passed as parameters
-- Key: run_id, robot, scope, capability?, context?
-- Units: since_us, until_us microseconds of run time, half-open: the period in which the outcome is this one, whichever
--   windows and rules give it; at seconds, by default after the end of every run
-- NULL: capability, context for all that have no row of their own; outcome when no record asks for review or certainly
--   denies (the end of a window would be on record, too) and the run does not observe policy, or not at that time
--   (facts/begun_before), or has rules but no record that the robot joined; since_us when the outcome has held since
--   the beginning of the run, or is unknown; until_us when it did not change later
-- Example: fsar-ledger query audit/policy_at LEDGER --param run=RUN --param robot=robot/D1 --param at=31.2
--   answers robot/D1: its own policy denies since 24.818 s, the fleet's rule since 31.07 s
-- Parameters: run: run = all, robot: robot = all, capability: capability = all, context: context = all, at: time = end
WITH asked AS (
    SELECT run_id, robot, scope, capability, context, since_us, strictness
    FROM policy_periods
    WHERE
        $run IN ('all', run_id) AND $robot IN ('all', robot)
        AND (capability IS NULL OR $capability IN ('all', capability))
        AND (context IS NULL OR $context IN ('all', context))
    WINDOW subject AS (PARTITION BY run_id, robot, scope)
    -- A capability or context without a rule of its own is among all others.
    QUALIFY
        ($capability = 'all' OR (capability IS NULL) = bool_and(capability IS NULL) OVER subject)
        AND ($context = 'all' OR (context IS NULL) = bool_and(context IS NULL) OVER subject)
),

moments AS (
    SELECT
        run_id, robot, scope,
        if($capability = 'all', capability, $capability) AS capability,
        if($context = 'all', context, $context) AS context,
        max(since_us) FILTER (WHERE since_us <= $at_us::BIGINT) AS since_us,
        min(since_us) FILTER (WHERE since_us > $at_us::BIGINT) AS until_us,
        coalesce(arg_max(strictness, since_us) FILTER (WHERE since_us <= $at_us::BIGINT), 1) AS strictness
    FROM asked
    GROUP BY ALL
),

strangers AS (
    -- Which rules hold for a robot that is not recorded as a member is unknown.
    SELECT DISTINCT run_id, robot FROM policy_subjects
    WHERE
        NOT is_member
        AND run_id IN (
            SELECT run_id FROM policy_events
            WHERE type IN ('PolicyRuleSet.v1', 'RolePolicyRuleSet.v1')
        )
),

known AS (
    -- A run that does not observe policy can show that something was not allowed, but never that it was.
    SELECT
        moments.run_id, moments.robot, moments.scope, moments.capability, moments.context, moments.since_us,
        moments.until_us, moments.strictness,
        moments.strictness = 3
        OR (moments.strictness = 2 AND strangers.run_id IS NULL)
        OR (
            coalesce(list_contains(runs.observes, 'policy'), FALSE)
            AND NOT EXISTS (
                FROM begun_before AS unseen
                WHERE
                    moments.run_id = unseen.run_id AND moments.robot = unseen.robot AND moments.scope = unseen.scope
                    AND unseen.what = 'window' AND $at_us::BIGINT < unseen.until_us
            )
            AND strangers.run_id IS NULL
        ) AS is_known
    FROM moments
    INNER JOIN runs ON moments.run_id = runs.run_id
    LEFT JOIN strangers ON moments.run_id = strangers.run_id AND moments.robot = strangers.robot
)

SELECT
    run_id, robot, scope, capability, context,
    if(is_known, list_extract(['allow', 'review', 'deny'], strictness), NULL) AS outcome,
    if(is_known, since_us, NULL) AS since_us,
    until_us
FROM known
