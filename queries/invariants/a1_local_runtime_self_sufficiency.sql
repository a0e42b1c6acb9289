-- Title: A1 broken: a robot needs others for its own steps or routine
-- Paper: sec:architecture:invariants (A1), eq:runtime
-- Grain: one row per own step or routine operation that another principal than the robot decided, or that has another
--   on its path; and per own execution without a decision
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: action_id for a routine, and where the record does not name it
-- Example: fsar-ledger query invariants/a1_local_runtime_self_sufficiency LEDGER
-- Decisions made before the record of another system began are not on record.
WITH decided AS (
    SELECT
        run_id, seq, time_us, type, task_id, action_id, decided_by, path,
        CASE WHEN type = 'OwnStepDecided.v1' THEN executed_by ELSE robot END AS owner
    FROM execution_events
    WHERE type IN ('OwnStepDecided.v1', 'RoutinePerformed.v1', 'RoutineWithheld.v1')
),

own_starts AS (
    SELECT
        starts.run_id, starts.seq, starts.time_us, starts.action_id, starts.robot,
        count(decided.seq) > 0 AS is_decided
    FROM execution_started AS starts
    LEFT JOIN decided
        ON
            starts.run_id = decided.run_id AND starts.seq > decided.seq AND starts.robot = decided.owner
            AND starts.task_id = decided.task_id AND starts.action_id = coalesce(decided.action_id, starts.action_id)
    ANTI JOIN actions_under_way AS earlier ON starts.run_id = earlier.run_id AND starts.action_id = earlier.action_id
    WHERE starts.robot = starts.on_behalf_of
    GROUP BY starts.run_id, starts.seq, starts.time_us, starts.action_id, starts.robot
)

SELECT
    run_id, seq, time_us, type, action_id,
    coalesce(decided_by, 'nobody on record')
    || coalesce(
        ' through '
        || nullif(array_to_string(list_filter(path, LAMBDA one: one IS DISTINCT FROM decided_by), ', '), ''),
        ''
    )
    || ' decides what is for '
    || coalesce(owner, 'a robot that is not on record')
    || ' alone to decide'
    || if(decided_by = owner AND coalesce(len(path), 0) = 0, ', and its path is not on record', '') AS found
FROM decided
WHERE decided_by IS DISTINCT FROM owner OR list_distinct(path) IS DISTINCT FROM [owner]
UNION ALL
SELECT
    run_id, seq, time_us,
    'ExecutionStarted.v1' AS type,
    action_id,
    robot || ' executes a step of its own that no record says was decided' AS found
FROM own_starts
WHERE NOT is_decided
