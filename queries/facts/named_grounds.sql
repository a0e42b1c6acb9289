-- Title: The windows and rules under which each request was denied or put to review, by name and in words
-- Paper: eq:policy, eq:admissible, eq:supervision
-- Grain: one row per event of facts/policies_seen that a window or rule on record explains
-- Key: run_id, seq
-- Units: names and ground_seqs side by side, positions in the run
-- NULL: never
-- Example: fsar-ledger query facts/named_grounds LEDGER
-- Stored: denials, messages and interventions read it
WITH named AS (
    -- A rule about a role can belong to the policies of two robots; it is named once.
    SELECT
        grounds.run_id, grounds.seq, grounds.ground_seq, grounds.window_name, grounds.robot, grounds.scope,
        grounds.capability, grounds.context, grounds.opened_us, grounds.closed_us, grounds.seen_us,
        grounds.review_every,
        coalesce(grounds.window_name, 'rule ' || grounds.ground_seq) AS name,
        row_number() OVER (
            PARTITION BY grounds.run_id, grounds.seq, grounds.ground_seq ORDER BY grounds.robot
        ) = 1 AS is_first
    FROM policy_grounds AS grounds
)

SELECT
    grounds.run_id, grounds.seq,
    list(grounds.name ORDER BY grounds.ground_seq) FILTER (grounds.is_first) AS names,
    list(grounds.ground_seq ORDER BY grounds.ground_seq) FILTER (grounds.is_first) AS ground_seqs,
    string_agg(
        concat(
            if(grounds.window_name IS NULL, '', 'window ') || grounds.name,
            CASE grounds.scope
                WHEN 'fleet' THEN ' of the fleet''s policy for ' || grounds.robot
                WHEN 'local' THEN ' of ' || grounds.robot || '''s local policy'
                ELSE ' of its supervisors, ' || if(
                    grounds.review_every = 1,
                    'a review of every admission by ',
                    'a review every ' || grounds.review_every || ' admissions by '
                ) || grounds.robot
            END,
            ' on ' || grounds.capability,
            ' in ' || grounds.context,
            if(grounds.window_name IS NULL, ', since ' || grounds.opened_us / 1000000 || ' s', ''),
            if(
                grounds.closed_us <= events.time_us,
                ', over since ' || grounds.closed_us / 1000000 || ' s, last seen at ' || grounds.seen_us / 1000000
                || ' s',
                ''
            )
        ),
        ' and ' ORDER BY grounds.ground_seq, grounds.robot
    ) AS told
FROM named AS grounds
INNER JOIN policies_seen AS events ON grounds.run_id = events.run_id AND grounds.seq = events.seq
GROUP BY grounds.run_id, grounds.seq
