-- Title: Calls for review: the subject, the robot with the policy, and when and where it was checked
-- Paper: eq:supervision, eq:policy
-- Grain: one row per SupervisorCalled event for review
-- Key: run_id, seq
-- Units: time_us, decided_us microseconds of run time; decided_seq, decided_us of the bid for a call about a bid, else
--   of the call
-- NULL: task_id, action_id, robot when no record names one; decided_by unless the call names a robot
-- Example: fsar-ledger query facts/review_calls LEDGER
-- Stored: it sorts the events of each task, and several queries read it
WITH bids AS (
    SELECT
        run_id, seq, time_us, action_id,
        coalesce(executed_by, 'robot/' || nullif(split_part(decided_by, '/', 2), '')) AS robot
    FROM request_admitted
    WHERE outcome = 'review'
),

asked AS (
    SELECT run_id, seq, action_id, executed_by
    FROM request_events
    WHERE type IN ('RequestIssued.v1', 'RequestRelayed.v1') AND executed_by IS NOT NULL
),

coordinated AS (
    SELECT run_id FROM copy_synced
    UNION
    SELECT run_id
    FROM request_events
    WHERE decided_by = 'coordinator'
)

-- The caller is not recorded. A coordinator names the robot that it has picked; without one, a robot that holds an
-- action names itself. A bidder has reported that its policy wants a review, an executor was asked before, and
-- otherwise the step is the robot's own.
SELECT
    called.run_id, called.seq, called.time_us, called.task_id, called.action_id,
    CASE
        WHEN called.robot IS NOT NULL THEN 'review'
        WHEN bids.seq IS NOT NULL THEN 'bid'
        WHEN asked.seq IS NOT NULL THEN 'review'
        ELSE 'own step'
    END AS reason,
    if(coordinated.run_id IS NULL OR called.robot IS NULL, called.robot, 'coordinator') AS decided_by,
    coalesce(called.robot, bids.robot, asked.executed_by, steps.robot) AS robot,
    if(called.robot IS NULL, coalesce(bids.seq, called.seq), called.seq) AS decided_seq,
    if(called.robot IS NULL, coalesce(bids.time_us, called.time_us), called.time_us) AS decided_us
FROM supervisor_called AS called
ASOF LEFT JOIN bids
    ON called.run_id = bids.run_id AND called.action_id = bids.action_id AND called.seq > bids.seq
ASOF LEFT JOIN asked
    ON called.run_id = asked.run_id AND called.action_id = asked.action_id AND called.seq > asked.seq
ASOF LEFT JOIN step_began AS steps
    ON called.run_id = steps.run_id AND called.task_id = steps.task_id AND called.seq > steps.seq
LEFT JOIN coordinated ON called.run_id = coordinated.run_id
WHERE called.purpose = 'review'
