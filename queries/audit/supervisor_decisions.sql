-- Title: Decisions of a supervisor: answers to calls, and interventions on its own initiative
-- Paper: eq:supervision, sec:architecture:fleet (human oversight console)
-- Grain: one row per SupervisorResponded event, and per other event that a supervisor decided (trust, rules, rights,
--   density, budgets)
-- Key: run_id, seq
-- Units: called_us, decided_us microseconds of run time; waited_us microseconds; under_seqs positions in the run
-- NULL: purpose, called_us, waited_us for a decision that answers no call; called_under, under_seqs (the windows and
--   rules that asked for the review) for one that answers no review, or a review that none on record explains;
--   decided_by when the record names no decider; robot, capability, action_id and the principals when the decision is
--   not about a particular one
-- Example: fsar-ledger query audit/supervisor_decisions LEDGER --param supervisor=supervisor/fleet
--   answers recovery of A1-1/4.1, called at 84.854 s, decided at 124.92 s
-- Parameters: run: run = all, supervisor: supervisor = all
WITH told AS (
    SELECT type, words
    FROM occurrence_words
    UNION ALL
    SELECT type, words
    FROM message_words
    WHERE part = 1 AND type NOT IN (SELECT occurrence_words.type FROM occurrence_words)
),

decided AS (
    SELECT
        run_id, seq,
        time_us AS decided_us,
        events.type, decided_by, action_id, requested_by, executed_by, robot, capability,
        CASE WHEN events.type = 'SupervisorResponded.v1' THEN purpose END AS purpose,
        CASE events.type
            WHEN 'SupervisorResponded.v1'
                THEN
                    CASE
                        WHEN preferred IS NOT NULL THEN preferred || ' first'
                        WHEN NOT approves THEN 'refused'
                        WHEN purpose = 'review' THEN 'approved'
                        ELSE if(purpose = 'recovery', 'resolved', 'ordered')
                    END
            WHEN 'RoleTrustSet.v1' THEN role || ' to ' || peer_role || ' ' || scope || coalesce(' in ' || context, '')
            WHEN 'TrustSet.v1' THEN peer || ' ' || scope || coalesce(' in ' || context, '')
            WHEN 'TrustThresholdsSet.v1'
                THEN 'promote after ' || promote_after || ', downgrade after ' || downgrade_after
            WHEN 'PolicyRuleSet.v1' THEN scope || ' ' || outcome || coalesce(' in ' || context, '')
            WHEN 'RolePolicyRuleSet.v1'
                THEN
                    role
                    || coalesce(' of ' || nullif(domain, ''), '')
                    || ' '
                    || scope
                    || ' '
                    || outcome
                    || coalesce(' in ' || context, '')
            WHEN 'SupervisionDensitySet.v1' THEN if(review_every = 0, 'no reviews', 'review every ' || review_every)
            WHEN 'AuthorityGranted.v1' THEN 'up to ' || override
            WHEN 'AuthorityRevoked.v1' THEN reason
            WHEN 'RecoveryBudgetSet.v1' THEN level || ' ' || n_max || ' in ' || t_max_us || ' us'
            ELSE told.words
        END AS decision
    FROM events
    LEFT JOIN told ON events.type = told.type
    WHERE
        (events.type = 'SupervisorResponded.v1' OR starts_with(decided_by, 'supervisor/'))
        AND $run IN ('all', run_id) AND $supervisor IN ('all', decided_by)
)

SELECT
    decided.run_id, decided.seq, decided.type, decided.decided_by, decided.purpose, decided.decision,
    decided.action_id, decided.robot, decided.capability, decided.requested_by, decided.executed_by,
    grounds.told AS called_under,
    grounds.ground_seqs AS under_seqs,
    calls.called_us, decided.decided_us,
    decided.decided_us - calls.called_us AS waited_us
FROM decided
LEFT JOIN answered_calls AS calls ON decided.run_id = calls.run_id AND decided.seq = calls.seq
LEFT JOIN named_grounds AS grounds ON decided.run_id = grounds.run_id AND calls.called_seq = grounds.seq
