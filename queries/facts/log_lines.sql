-- Title: Every event as a readable line: when, who tells whom what or does what, and details from the record
-- Paper: sec:evaluation:metrics (audit attributability)
-- Grain: one row per event
-- Key: run_id, seq
-- Units: time_s seconds of run time; clock the time in UTC
-- NULL: clock of a run whose start is unknown; concern of an event that describes a run or an experiment; action_id
--   when the record names none; sender, receiver when the record does not name them; note when there is nothing to add
-- Example: fsar-ledger query facts/log_lines LEDGER
-- A robot's own deed, and anything that happens to a robot, has the robot as sender and receiver. A registry's answer
-- is in the note of the question.
WITH told AS (
    SELECT
        run_id, seq, time_us, type, action_id,
        min_by(sender, part) AS sender,
        min_by(receiver, part) AS receiver,
        min_by(message, part) AS message,
        string_agg(nullif(concat_ws('; ', CASE WHEN part > 1 THEN message END, note), ''), '; ' ORDER BY part) AS note
    FROM messages
    GROUP BY run_id, seq, time_us, type, action_id
),

lines AS (
    SELECT run_id, seq, time_us, type, action_id, sender, receiver, message, note
    FROM told
    UNION ALL
    SELECT run_id, seq, time_us, type, action_id, sender, receiver, message, note
    FROM occurrences
)

SELECT
    lines.run_id, lines.seq,
    lines.time_us / 1000000 AS time_s,
    strftime(begun.epoch + to_microseconds(lines.time_us), '%Y-%m-%dT%H:%M:%S.%gZ') AS clock,
    lines.type, event_concerns.concern, lines.sender, lines.receiver, lines.message,
    lines.note, lines.action_id
FROM lines
LEFT JOIN event_concerns ON lines.type = event_concerns.type
LEFT JOIN run_epochs AS begun ON lines.run_id = begun.run_id
