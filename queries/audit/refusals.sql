-- Title: Refusals by reason and failed conjunct: requests denied, countered or unanswered, help declined, executions
--   held, commands rejected
-- Paper: sec:model:request, eq:admissible
-- Grain: one row per run, type of refusal, reason and principal that decided it
-- Key: run_id, type, reason?, decided_by?
-- Units: refusals count; first_us, last_us microseconds of run time
-- NULL: decided_by when the record names no decider; conjunct when the refusal is no part of eq:admissible; an
--   unanswered request, declined help and a counter-offer have the reason that their type implies, NULL where no robot
--   is known to have been asked and the run does not observe registry
-- Example: fsar-ledger query audit/refusals LEDGER --param run=RUN
--   answers RequestDenied, policy (conjunct policy), by robot/B1: 1, at 31.046 s
-- Parameters: run: run = all, reason: reason = all
WITH offered AS (
    SELECT run_id, action_id, min(seq) AS seq
    FROM registry_queried
    WHERE len(candidates) > 0
    GROUP BY run_id, action_id
),

refused AS (
    SELECT
        events.run_id, events.time_us, events.type,
        CASE events.type
            WHEN 'RequestUnanswered.v1'
                THEN
                    CASE
                        WHEN events.executed_by IS NOT NULL OR offered.seq < events.seq THEN 'no answer'
                        WHEN list_contains(runs.observes, 'registry') THEN 'no candidate'
                    END
            WHEN 'AssistanceDeclined.v1' THEN 'helper declined'
            WHEN 'RequestCountered.v1' THEN 'override'
            ELSE events.reason
        END AS reason,
        CASE events.type WHEN 'AssistanceDeclined.v1' THEN events.helper ELSE events.decided_by END AS decided_by
    FROM event_principals AS events
    INNER JOIN runs ON events.run_id = runs.run_id
    LEFT JOIN offered ON events.run_id = offered.run_id AND events.action_id = offered.action_id
    WHERE
        events.type IN (
            'RequestDenied.v1',
            'RequestCountered.v1',
            'RequestUnanswered.v1',
            'AssistanceDeclined.v1',
            'ExecutionHeld.v1',
            'CommandRejected.v1'
        )
)

SELECT
    refused.run_id, refused.type, refused.reason, known.conjunct, refused.decided_by,
    count(*) AS refusals,
    min(refused.time_us) AS first_us,
    max(refused.time_us) AS last_us
FROM refused
LEFT JOIN refusal_reasons AS known ON refused.reason = known.reason AND refused.type <> 'CommandRejected.v1'
WHERE $run IN ('all', refused.run_id) AND $reason IN ('all', refused.reason)
GROUP BY refused.run_id, refused.type, refused.reason, known.conjunct, refused.decided_by
