-- Title: Refusals and holds of actions that the fleet mandates but the executor's policy denies, and their escalation
-- Paper: sec:architecture:fleet, sec:architecture:invariants (A3)
-- Grain: one row per RequestDenied event for reasons of policy, and per ExecutionHeld event under the executor's own
--   denial, where rules of the fleet explicitly allow and the executor's own policy denies
-- Key: run_id, seq
-- Units: time_us microseconds of run time; seq, mandate_seq, escalated_seq positions in the run
-- NULL: escalated_seq when the conflict was not escalated
-- Example: fsar-ledger query facts/mandate_conflicts LEDGER
-- Stored: several invariants of an audit read it
WITH mandated AS (
    -- The fleet allows if each of its applicable rules does.
    SELECT
        stops.run_id, stops.seq, stops.time_us, stops.task_id, stops.action_id, stops.robot, stops.capability,
        stops.previous_seq,
        max(rules.seq) AS mandate_seq
    FROM policy_stops AS stops
    INNER JOIN policy_rules AS rules
        ON
            stops.run_id = rules.run_id AND stops.robot = rules.robot AND rules.scope = 'fleet'
            AND stops.seq > rules.seq AND stops.seq < coalesce(rules.until_seq, stops.seq + 1)
            AND (rules.capability IS NULL OR stops.capability = rules.capability)
            AND (rules.context IS NULL OR stops.task_id = rules.context)
    GROUP BY ALL
    HAVING bool_and(rules.outcome = 'allow')
),

heard AS (
    -- The fleet's rule for the executor's zone, as last told to the executor.
    SELECT mandated.run_id, mandated.seq, told.outcome
    FROM mandated
    ASOF JOIN fleet_rule_learned AS told
        ON mandated.run_id = told.run_id AND mandated.robot = told.robot AND mandated.seq > told.seq
)

SELECT
    mandated.run_id, mandated.seq, mandated.time_us, mandated.action_id, mandated.robot, mandated.mandate_seq,
    max(escalated.seq) AS escalated_seq
FROM mandated
INNER JOIN policy_windows AS own
    ON
        mandated.run_id = own.run_id AND mandated.robot = own.robot AND own.scope = 'local' AND own.outcome = 'deny'
        AND mandated.seq > own.seq AND mandated.seq < coalesce(own.closed_seq, mandated.seq + 1)
        AND (own.capability IS NULL OR mandated.capability = own.capability)
        AND (own.context IS NULL OR mandated.task_id = own.context)
LEFT JOIN heard ON mandated.run_id = heard.run_id AND mandated.seq = heard.seq
LEFT JOIN policy_conflict_escalated AS escalated
    ON
        mandated.run_id = escalated.run_id AND mandated.action_id = escalated.action_id
        AND mandated.seq > escalated.seq AND mandated.previous_seq < escalated.seq
WHERE coalesce(heard.outcome, 'allow') = 'allow'
GROUP BY ALL
