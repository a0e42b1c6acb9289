-- Title: A3 broken: a known conflict of policies is ignored instead of escalated
-- Paper: sec:architecture:invariants (A3), eq:policy
-- Grain: one row per start under a known deny or unapproved review, or after a refusal or hold that still stands; per
--   admission milder than what the last request carried; and per stop against a mandate that was not escalated
-- Key: run_id, seq, found
-- Units: time_us microseconds of run time
-- NULL: action_id for a motion
-- Example: fsar-ledger query invariants/a3_no_silent_policy_override LEDGER
WITH holds AS (
    SELECT
        begun.run_id, begun.seq,
        max(held.seq) AS held_seq,
        greatest(max(ends.seq), any_value(answers.seq) FILTER (answers.is_approved)) AS changed_seq
    FROM execution_started AS begun
    INNER JOIN execution_held AS held
        ON
            begun.run_id = held.run_id AND begun.action_id = held.action_id AND begun.robot = held.robot
            AND begun.seq > held.seq
    LEFT JOIN hold_ends AS ends
        ON begun.run_id = ends.run_id AND begun.robot = ends.robot AND begun.seq > ends.seq
    ASOF LEFT JOIN review_answers AS answers
        ON begun.run_id = answers.run_id AND begun.action_id = answers.action_id AND begun.seq > answers.seq
    GROUP BY begun.run_id, begun.seq
),

admissions AS (
    SELECT
        admitted.run_id, admitted.seq,
        coalesce(any_value(answers.is_approved), FALSE) AS is_approved,
        max(CASE told.outcome WHEN 'deny' THEN 2 WHEN 'review' THEN 1 ELSE 0 END) AS carried
    FROM request_admitted AS admitted
    INNER JOIN policies_carried AS told
        ON
            admitted.run_id = told.run_id AND admitted.action_id = told.action_id
            AND admitted.seq BETWEEN told.seq + 1 AND coalesce(told.replaced_seq, admitted.seq)
    ASOF LEFT JOIN review_answers AS answers
        ON admitted.run_id = answers.run_id AND admitted.action_id = answers.action_id AND admitted.seq > answers.seq
    GROUP BY admitted.run_id, admitted.seq
),

findings AS (
    SELECT
        run_id, seq,
        coalesce(
            'starts after the refusal at seq ' || denied_seq || ', which nothing lifted',
            'starts under a known ' || if(outcome = 'deny', 'deny', 'review that no supervisor had approved')
        ) AS found
    FROM known_policy
    WHERE denied_seq IS NOT NULL OR outcome <> 'allow'
    UNION ALL
    SELECT run_id, seq, 'starts after the hold at seq ' || held_seq || ', and nothing has changed since' AS found
    FROM holds
    WHERE held_seq > coalesce(changed_seq, -1)
    UNION ALL
    SELECT
        admitted.run_id, admitted.seq,
        'admitted as ' || admitted.outcome
        || if(admissions.carried > 0, ' although the request carried ', ', which is no admission')
        || coalesce(list_extract(['', 'review', 'deny'], admissions.carried + 1), '') AS found
    FROM request_admitted AS admitted
    LEFT JOIN admissions ON admitted.run_id = admissions.run_id AND admitted.seq = admissions.seq
    WHERE
        admitted.outcome = 'deny' OR admissions.carried = 2
        OR (admissions.carried = 1 AND admitted.outcome = 'allow' AND NOT admissions.is_approved)
    UNION ALL
    SELECT
        run_id, seq,
        'stops what the rule at seq ' || mandate_seq || ' mandates, and nobody was told of the conflict' AS found
    FROM mandate_conflicts
    WHERE escalated_seq IS NULL
)

SELECT findings.run_id, findings.seq, events.time_us, events.type, events.action_id, findings.found
FROM findings
INNER JOIN event_principals AS events ON findings.run_id = events.run_id AND findings.seq = events.seq
WHERE
    events.type IN (
        'ExecutionStarted.v1', 'RoutinePerformed.v1', 'RequestAdmitted.v1', 'RequestDenied.v1', 'ExecutionHeld.v1'
    )
