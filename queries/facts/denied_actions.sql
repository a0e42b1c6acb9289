-- Title: Denials of requests, with the action that each is about and the windows or rules under which it fell
-- Paper: eq:admissible, eq:policy, sec:model:request
-- Grain: one row per RequestDenied event
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when neither the record nor what caused it names one; a principal that the record does not name;
--   denied_under (their names) and grounds (in words) when no window or rule on record explains the denial
-- Example: fsar-ledger query facts/denied_actions LEDGER
WITH RECURSIVE causes AS (
    SELECT run_id, seq, caused_by, action_id
    FROM keyed_events
    WHERE type = 'RequestDenied.v1'
    UNION ALL
    -- A record that names no action is about the action of its cause.
    SELECT causes.run_id, causes.seq, earlier.caused_by, earlier.action_id
    FROM causes
    INNER JOIN keyed_events AS earlier ON causes.run_id = earlier.run_id AND causes.caused_by = earlier.seq
    WHERE causes.action_id IS NULL
),

actions AS (
    SELECT run_id, seq, max(action_id) AS action_id
    FROM causes
    GROUP BY run_id, seq
),

grounds AS (
    SELECT
        run_id, seq,
        list(coalesce("window", 'rule ' || ground_seq) ORDER BY ground_seq, robot) AS denied_under,
        string_agg(
            if("window" IS NULL, 'rule ' || ground_seq, 'window ' || "window") || ' of '
            || if(scope = 'fleet', 'the fleet''s policy for ' || robot, robot || '''s local policy'),
            ' and ' ORDER BY ground_seq, robot
        ) AS grounds
    FROM denial_grounds
    GROUP BY run_id, seq
)

SELECT
    denied.run_id, denied.seq, denied.time_us, actions.action_id, denied.requested_by, denied.executed_by,
    denied.decided_by, denied.reason, grounds.denied_under, grounds.grounds, denied.supervised_by
FROM request_denied AS denied
INNER JOIN actions ON denied.run_id = actions.run_id AND denied.seq = actions.seq
LEFT JOIN grounds ON denied.run_id = grounds.run_id AND denied.seq = grounds.seq
