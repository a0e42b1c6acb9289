-- Title: The recovery of a failure, level by level: what was tried, the result, how long each level took and why it was
--   left
-- Paper: fig:wf3, eq:recovery
-- Grain: one row per recovery step about a failure; the resolution is the last
-- Key: run_id, action_id, failure, seq
-- Units: step counts from 1 within the failure; level_number 1 local to 4 human; time_s, until_s seconds of run time;
--   spent_s seconds at the level in all; budget_s seconds from detection to the deadline of the attempt
-- NULL: decided_by when the record names none; result when there was none or none is recorded; until_s of the last
--   step; to_level unless an escalation; budget_s where no attempt has a deadline; achieved when nothing was achieved;
--   budget_s, and spent_s of the first level, when the failure itself is not on record; spent_s of the last level, when
--   no resolution is on record and the run does not record resolutions, and of a level that recovery came to or left
--   where the run does not record escalations
-- Example: fsar-ledger query audit/failure_timeline LEDGER --param run=RUN --param action=A1-1/2.1
--   answers attempt 1 and 2 at robot/D1 in vain, no peer, no reassignment, supervisor/fleet resolved it; 4.356, 0.196,
--   0.571 and 24.384 s
-- Parameters: run: run = all, action: action = all
WITH telling AS (
    SELECT
        run_id,
        list_cat(observes, records) AS told,
        list_has_any(told, ['recovery', 'FailureResolved']) AS tells_ends,
        list_has_any(told, ['recovery', 'RecoveryEscalated']) AS tells_moves
    FROM run_started
),

steps AS (
    SELECT
        recovery_steps.run_id, action_id, failure, detected_us, seq, time_us, until_us, decided_by, level, to_level,
        deadline_us, what, achieved,
        -- Of several calls for a human, the last one resolved the failure.
        CASE
            WHEN type <> 'SupervisorCalled.v1' OR lead(type) OVER in_order = 'FailureResolved.v1' THEN result
        END AS result,
        row_number() OVER in_order AS step,
        -- A step after an escalation began with it; the first step began at the detection.
        CASE
            WHEN lag(type) OVER in_order = 'RecoveryEscalated.v1' THEN lag(time_us) OVER in_order
            WHEN NOT tells_moves AND coalesce(lag(level) OVER in_order, 'local') <> level THEN NULL
            ELSE if(lag(seq) OVER in_order IS NULL, detected_us, time_us)
        END AS since_us,
        CASE
            WHEN type IN ('RecoveryEscalated.v1', 'FailureResolved.v1') THEN time_us
            WHEN NOT tells_moves AND lead(level) OVER in_order <> level THEN NULL
            WHEN until_us IS NOT NULL THEN until_us
            WHEN tells_ends THEN time_us
        END AS over_us
    FROM recovery_steps
    INNER JOIN telling ON recovery_steps.run_id = telling.run_id
    WHERE $run IN ('all', recovery_steps.run_id) AND $action IN ('all', action_id)
    WINDOW in_order AS (PARTITION BY recovery_steps.run_id, action_id, failure ORDER BY seq)
)

SELECT
    run_id, action_id, failure, step, seq,
    list_position(['local', 'peer', 'fleet', 'human'], level) AS level_number,
    level, to_level,
    time_us / 1000000 AS time_s,
    until_us / 1000000 AS until_s,
    decided_by, what,
    result, achieved,
    (deadline_us - detected_us) / 1000000 AS budget_s,
    if(bool_and(since_us + over_us IS NOT NULL) OVER stay, max(over_us) OVER stay - min(since_us) OVER stay, NULL)
    / 1000000 AS spent_s
FROM steps
WINDOW stay AS (PARTITION BY run_id, action_id, failure, level)
