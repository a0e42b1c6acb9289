-- Title: Callers of supervisors and receivers of their answers, neither of which is recorded
-- Paper: eq:supervision
-- Grain: one row per SupervisorCalled and SupervisorResponded event
-- Key: run_id, seq
-- Units: none
-- NULL: caller of an answer, of a call in a record of another system, and where no record names one: for a review that
--   names a robot it is the coordinator, or that robot where no coordinator decides; the requester for one about a bid,
--   for recovery the last decider named, else the last executor named or the robot whose step it is; asker of a call,
--   and of an answer whose records name none: it is the executor that the answer names, or the caller, else the
--   requester (not in a record of another system), or the supervisor itself
-- Example: fsar-ledger query facts/supervision_ends LEDGER
WITH named AS (
    SELECT
        keyed_events.run_id, keyed_events.seq, keyed_events.type, keyed_events.action_id, events.purpose, events.robot,
        events.decided_by, events.requested_by, events.executed_by, events.supervised_by,
        last_value(events.decided_by IGNORE NULLS) OVER earlier AS last_decider,
        last_value(events.requested_by IGNORE NULLS) OVER earlier AS last_requester,
        last_value(events.executed_by IGNORE NULLS) OVER earlier AS last_executor
    FROM keyed_events
    INNER JOIN events ON keyed_events.run_id = events.run_id AND keyed_events.seq = events.seq
    WHERE
        events.type IN (SELECT message_words.type FROM message_words)
        AND (events.type <> 'AuthorityClaimed.v1' OR events.reason = 'revocation')
    WINDOW earlier AS (
        PARTITION BY keyed_events.run_id, keyed_events.action_id ORDER BY keyed_events.seq
        ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
    )
),

ends AS (
    SELECT
        named.run_id, named.seq, named.type, named.action_id, named.purpose, named.decided_by, named.requested_by,
        named.executed_by, named.supervised_by, runs.kind,
        CASE
            WHEN named.type <> 'SupervisorCalled.v1' OR runs.kind = 'foreign' THEN NULL
            WHEN named.purpose = 'review' AND named.robot IS NOT NULL THEN calls.decided_by
            WHEN named.purpose = 'recovery' THEN named.last_decider
            WHEN calls.reason = 'bid' THEN named.last_requester
            ELSE coalesce(named.last_executor, calls.robot)
        END AS caller
    FROM named
    INNER JOIN runs ON named.run_id = runs.run_id
    LEFT JOIN review_calls AS calls ON named.run_id = calls.run_id AND named.seq = calls.seq
    WHERE named.type IN ('SupervisorCalled.v1', 'SupervisorResponded.v1')
)

SELECT
    run_id, seq, caller,
    if(
        type = 'SupervisorResponded.v1',
        coalesce(
            executed_by,
            last_value(caller IGNORE NULLS) OVER (PARTITION BY run_id, action_id, purpose ORDER BY seq),
            if(kind = 'foreign', NULL, requested_by), decided_by, supervised_by
        ),
        NULL
    ) AS asker
FROM ends
