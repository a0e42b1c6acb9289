-- Title: Case 2, run by run: whether robots contain their failures, escalate them at once, or dispute who recovers
-- Paper: sec:evaluation:qualitative (case 2), sec:model:recovery
-- Grain: one row per claim and run of the scenario with a failure; the claims on degradation look only at failures of
--   worn actuators of robots of role D
-- Key: run_id, claim
-- Units: counted 1 or 0; seq the first failure; evidence the failures counted, or for a loop the claims and the
--   escalation: positions in the run
-- NULL: never
-- Example: fsar-ledger query cases/case_2_evidence LEDGER
-- A loop: two agents claim override of the failed action at once, one of them recovers it, then it escalates (R46).
WITH told AS (
    SELECT
        failures.run_id, failures.seq, failures.action_id, failures.failure,
        coalesce(failures.cause = 'degradation' AND robots.role = 'D', FALSE) AS is_worn,
        failures.resolved_level = 'local' AS is_local
    FROM failures
    INNER JOIN runs ON failures.run_id = runs.run_id
    LEFT JOIN robot_joined AS robots ON failures.run_id = robots.run_id AND failures.robot = robots.robot
    WHERE runs.scenario = 'failure-recovery-chain'
),

acted AS (
    SELECT
        run_id, action_id, failure,
        first(decided_by ORDER BY seq) FILTER (type <> 'FailureResolved.v1') AS first_by,
        list(DISTINCT decided_by) AS deciders,
        coalesce(bool_and(regexp_matches(decided_by, '^(robot|agent)/')), TRUE) AS is_by_the_robot,
        max(seq) FILTER (type = 'RecoveryEscalated.v1') AS escalated_seq
    FROM recovery_steps
    GROUP BY run_id, action_id, failure
),

loops AS (
    SELECT told.run_id, told.seq, min(recovering.seq) AS claim_seq, min(other.seq) AS other_seq
    FROM told
    INNER JOIN acted ON told.run_id = acted.run_id AND told.action_id = acted.action_id AND told.failure = acted.failure
    INNER JOIN claims AS recovering
        ON
            told.run_id = recovering.run_id AND told.action_id = recovering.action_id
            AND recovering.dimension = 'override' AND told.seq < recovering.seq AND acted.escalated_seq > recovering.seq
            AND list_contains(acted.deciders, recovering.claimant)
    INNER JOIN claims AS other
        ON
            recovering.run_id = other.run_id AND recovering.action_id = other.action_id
            AND recovering.dimension = other.dimension AND recovering.claimant <> other.claimant
            AND starts_with(recovering.claimant, 'agent/') AND starts_with(other.claimant, 'agent/')
            AND coalesce(recovering.ended_us > other.began_us, TRUE)
            AND coalesce(recovering.began_us < other.ended_us, TRUE)
    GROUP BY told.run_id, told.seq
),

judged AS (
    SELECT
        told.run_id, told.seq, told.is_worn,
        unnest(['contained locally', 'escalated at once', 'recovery loop']) AS claim,
        unnest([
            coalesce(told.is_local AND acted.is_by_the_robot, FALSE),
            coalesce(NOT regexp_matches(acted.first_by, '^(robot|agent|supervisor)/'), FALSE),
            loops.seq IS NOT NULL
        ]) AS is_so,
        unnest([[told.seq], [told.seq], [loops.claim_seq, loops.other_seq, acted.escalated_seq]]) AS evidence
    FROM told
    LEFT JOIN acted ON told.run_id = acted.run_id AND told.action_id = acted.action_id AND told.failure = acted.failure
    LEFT JOIN loops ON told.run_id = loops.run_id AND told.seq = loops.seq
)

SELECT
    run_id,
    claim || suffix.suffix AS claim,
    min(seq) AS seq,
    (CASE claim WHEN 'recovery loop' THEN bool_or(is_so) ELSE bool_and(is_so) END)::BIGINT AS counted,
    if(
        claim = 'recovery loop' OR bool_and(is_so),
        list_sort(list_distinct(flatten(coalesce(list(evidence) FILTER (is_so), [])))), []
    ) AS evidence
FROM judged
INNER JOIN (VALUES ('', FALSE), (' (degradation)', TRUE)) AS suffix (suffix, needs_wear)
    ON judged.is_worn OR NOT suffix.needs_wear
GROUP BY run_id, claim, suffix.suffix
