-- Title: I2 broken: a delegated action is executed without its executor's own acceptance, or admitted despite a
--   revocation
-- Paper: sec:model:invariants (I2), eq:request
-- Grain: one row per ExecutionStarted event for another robot without an earlier acceptance, by the executing robot, of
--   that action, and per admission of a request that the asking robot had no right to any more
-- Key: run_id, seq
-- Units: time_us microseconds of run time
-- NULL: never
-- Example: fsar-ledger query invariants/i2_local_execution_ownership LEDGER
-- An acceptance counts when the executing robot decided it, it names that robot as executor, and its path has no other
-- principal. That of an action that was under way when the record of another system began is not on record.
WITH acceptances AS (
    SELECT
        starts.run_id, starts.seq,
        arg_max(coalesce(accepted.decided_by, 'somebody not on record'), accepted.seq) AS decided_by,
        arg_max(coalesce(accepted.executed_by, 'nobody'), accepted.seq) AS executor,
        arg_max(array_to_string(list_filter(accepted.path, LAMBDA one: one <> starts.robot), ', '), accepted.seq)
            AS through,
        coalesce(
            bool_or(
                accepted.decided_by = starts.robot
                AND accepted.executed_by = starts.robot
                AND list_distinct(accepted.path) = [starts.robot]
            ),
            FALSE
        ) AS is_own
    FROM execution_started AS starts
    LEFT JOIN request_accepted AS accepted
        ON starts.run_id = accepted.run_id AND starts.action_id = accepted.action_id AND starts.seq > accepted.seq
    ANTI JOIN actions_under_way AS earlier ON starts.run_id = earlier.run_id AND starts.action_id = earlier.action_id
    WHERE starts.robot <> starts.on_behalf_of
    GROUP BY starts.run_id, starts.seq
)

SELECT
    starts.run_id, starts.seq, starts.time_us,
    'ExecutionStarted.v1' AS type,
    starts.action_id,
    starts.robot || ' executes for ' || starts.on_behalf_of || CASE
        WHEN acceptances.decided_by IS NULL THEN ' what nobody had accepted'
        WHEN
            acceptances.is_own
            THEN ', but the record names ' || coalesce(starts.executed_by, 'nobody') || ' as executor'
        WHEN acceptances.decided_by <> starts.robot THEN ' what ' || acceptances.decided_by || ' had accepted'
        WHEN acceptances.executor <> starts.robot
            THEN ' what it had accepted, but the acceptance names ' || acceptances.executor || ' as executor'
        ELSE
            ' what it had accepted '
            || coalesce('through ' || nullif(acceptances.through, ''), 'by a path that is not on record')
    END AS found
FROM execution_started AS starts
INNER JOIN acceptances ON starts.run_id = acceptances.run_id AND starts.seq = acceptances.seq
WHERE NOT acceptances.is_own OR starts.executed_by IS DISTINCT FROM starts.robot
UNION ALL
SELECT
    run_id, seq, time_us, type, action_id,
    executed_by || ' admits what ' || asker || ' may not ask since seq ' || right_seq AS found
FROM rights_at_evaluations
WHERE verdict = 'admitted' AND is_revoked
