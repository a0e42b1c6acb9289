-- Title: Denials of requests, with the action that each is about and the windows or rules under which it fell
-- Paper: eq:admissible, eq:policy, sec:model:request
-- Grain: one row per RequestDenied event
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id when neither the record nor what caused it names one; a principal that the record does not name;
--   denied_under, under_seqs (names and positions of the windows and rules, side by side) when none on record explains
--   the denial; note (of whom it was asked, the windows and rules, through whom, who supervised) when the record names
--   none of these
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
),

named AS (
    -- A rule about a role can be one of two robots' policies; it is named once.
    SELECT
        run_id, seq, ground_seq, window_name, robot, scope, closed_us, seen_us,
        coalesce(window_name, 'rule ' || ground_seq) AS name,
        row_number() OVER (PARTITION BY run_id, seq, ground_seq ORDER BY robot) = 1 AS is_first
    FROM denial_grounds
),

grounds AS (
    SELECT
        under.run_id, under.seq,
        list(under.name ORDER BY under.ground_seq) FILTER (under.is_first) AS denied_under,
        list(under.ground_seq ORDER BY under.ground_seq) FILTER (under.is_first) AS under_seqs,
        string_agg(
            if(under.window_name IS NULL, '', 'window ') || under.name || ' of '
            || if(under.scope = 'fleet', 'the fleet''s policy for ' || under.robot, under.robot || '''s local policy')
            || if(
                under.closed_us <= denied.time_us,
                ', over since ' || under.closed_us / 1000000 || ' s, last seen at ' || under.seen_us / 1000000 || ' s',
                ''
            ),
            ' and ' ORDER BY under.ground_seq, under.robot
        ) AS grounds
    FROM named AS under
    INNER JOIN request_denied AS denied ON under.run_id = denied.run_id AND under.seq = denied.seq
    GROUP BY under.run_id, under.seq
)

SELECT
    denied.run_id, denied.seq, denied.time_us, actions.action_id, denied.requested_by, denied.executed_by,
    denied.decided_by, denied.reason, grounds.denied_under, grounds.under_seqs, denied.supervised_by,
    nullif(concat_ws(
        '; ',
        'asked of ' || if(denied.executed_by = denied.decided_by, NULL, denied.executed_by),
        'under ' || grounds.grounds,
        'decided through '
        || nullif(array_to_string(list_filter(denied.path, LAMBDA one: one <> denied.decided_by), ', '), ''),
        'supervised by ' || denied.supervised_by
    ), '') AS note
FROM request_denied AS denied
INNER JOIN actions ON denied.run_id = actions.run_id AND denied.seq = actions.seq
LEFT JOIN grounds ON denied.run_id = grounds.run_id AND denied.seq = grounds.seq
