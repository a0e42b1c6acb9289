-- Title: Denials of requests, with the action that each is about and the windows or rules under which it fell
-- Paper: eq:admissible, eq:policy, sec:model:request
-- Grain: one row per RequestDenied event
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when neither the record nor its cause names one; a principal that the record does not name;
--   denied_under, under_seqs (names and positions of windows and rules) when none on record explains the denial; note
--   (the robot asked, the windows and rules, the relay, the supervisor) when the record names none of these
-- Example: fsar-ledger query facts/denied_actions LEDGER
-- Stored: requests, messages and denials read it
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
)

SELECT
    denied.run_id, denied.seq, denied.time_us, actions.action_id, denied.requested_by, denied.executed_by,
    denied.decided_by, denied.reason, grounds.names AS denied_under,
    grounds.ground_seqs AS under_seqs, denied.supervised_by,
    nullif(concat_ws(
        '; ',
        'asked of ' || if(denied.executed_by = denied.decided_by, NULL, denied.executed_by),
        'under ' || grounds.told,
        'decided through '
        || nullif(array_to_string(list_filter(denied.path, LAMBDA one: one <> denied.decided_by), ', '), ''),
        'supervised by ' || denied.supervised_by
    ), '') AS note
FROM request_denied AS denied
INNER JOIN actions ON denied.run_id = actions.run_id AND denied.seq = actions.seq
LEFT JOIN named_grounds AS grounds ON denied.run_id = grounds.run_id AND denied.seq = grounds.seq
