-- Title: Case 4, handoff by handoff: coordination events from the gap to the result, those not attributable, and
--   internal messages
-- Paper: sec:evaluation:qualitative (case 4), sec:evaluation:metrics (audit attributability)
-- Grain: one row per claim and handoff of the scenario: an action that a robot of role A asks one of role D to do and
--   whose execution has ended
-- Key: run_id, claim, seq
-- Units: counted coordination events; seq the beginning of the step, evidence the events counted: positions in the run
-- NULL: never; evidence is empty where nothing is counted
-- Example: fsar-ledger query cases/case_4_evidence LEDGER
-- A record belongs to the action that it names, else to that of its nearest cause that names one. The paper's chain
-- ends with the result and has no disturbances: records of failures and of new plans are not counted (R46).
WITH RECURSIVE handoffs AS (
    SELECT
        begun.run_id, begun.action_id,
        min(begun.seq) AS seq
    FROM step_began AS begun
    INNER JOIN runs ON begun.run_id = runs.run_id
    INNER JOIN execution_finished AS ended ON begun.run_id = ended.run_id AND begun.action_id = ended.action_id
    INNER JOIN robot_joined AS askers ON begun.run_id = askers.run_id AND begun.robot = askers.robot
    INNER JOIN robot_joined AS executors ON ended.run_id = executors.run_id AND ended.robot = executors.robot
    WHERE runs.scenario = 'collaborative-delivery' AND askers.role = 'A' AND executors.role = 'D'
    GROUP BY begun.run_id, begun.action_id
),

chronicle AS (
    SELECT *
    FROM event_principals
    WHERE run_id IN (SELECT handoffs.run_id FROM handoffs)
),

records AS (
    SELECT
        chronicle.run_id, chronicle.seq, chronicle.action_id, chronicle.caused_by, judged.is_attributable,
        CASE
            WHEN chronicle.sender IS NULL THEN 'chain'
            WHEN coalesce(robots.role, '') <> 'D' THEN 'elsewhere'
            WHEN
                regexp_matches(
                    chronicle.sender || chronicle.receiver, '/(communication.*/planning|planning.*/execution)$'
                )
                THEN 'inward'
            ELSE 'internal'
        END AS kind
    FROM coordination_events AS judged
    INNER JOIN chronicle ON judged.run_id = chronicle.run_id AND judged.seq = chronicle.seq
    LEFT JOIN robot_joined AS robots ON judged.run_id = robots.run_id AND judged.part_of = robots.robot
    WHERE judged.record_kind NOT IN ('routine', 'replan') AND chronicle.failure IS NULL
),

ties AS (
    SELECT run_id, seq, kind, is_attributable, action_id, caused_by
    FROM records
    UNION ALL
    SELECT ties.run_id, ties.seq, ties.kind, ties.is_attributable, causes.action_id, causes.caused_by
    FROM ties
    INNER JOIN chronicle AS causes ON ties.run_id = causes.run_id AND ties.caused_by = causes.seq
    WHERE ties.action_id IS NULL
)

SELECT
    handoffs.run_id, claims.claim, handoffs.seq,
    count(ties.seq) AS counted,
    list_sort(coalesce(list(ties.seq) FILTER (ties.seq IS NOT NULL), [])) AS evidence
FROM handoffs
CROSS JOIN (
    VALUES
    ('events', ['chain'], [FALSE, TRUE]), ('unattributed events', ['chain'], [FALSE]),
    ('internal events', ['internal', 'inward'], [FALSE]), ('internal events (inward)', ['inward'], [FALSE])
) AS claims (claim, kinds, marks)
LEFT JOIN ties
    ON
        handoffs.run_id = ties.run_id AND handoffs.action_id = ties.action_id
        AND list_contains(claims.kinds, ties.kind) AND list_contains(claims.marks, ties.is_attributable)
GROUP BY handoffs.run_id, claims.claim, handoffs.seq
