-- Title: The budget of each level of a robot's recovery, from each time at which it was set
-- Paper: eq:recovery, app:foundations (Paper 3)
-- Grain: one row per run, robot and level for the initial settings of the fleet, and per RecoveryBudgetSet event
-- Key: run_id, robot, level, since_seq
-- Units: t_max_us microseconds; n_max attempts (local), helpers asked (peer), reassignments (fleet), calls (human);
--   since_seq position in the run
-- NULL: t_max_us, n_max where the run records neither, or where its parameters are unreadable; set_by where the budget
--   is the fleet's own
-- Example: fsar-ledger query facts/recovery_allowances LEDGER
WITH readable AS (
    SELECT
        run_id, seq,
        CASE WHEN json_valid(parameters) THEN parameters END AS constants
    FROM run_started
),

founding AS (
    SELECT
        runs.run_id,
        runs.seq AS since_seq,
        counts.level,
        try_cast(json_extract(runs.constants, '$.structure.' || counts.level || '_budget_us') AS BIGINT) AS t_max_us,
        try_cast(json_extract(runs.constants, '$.structure.' || counts.name) AS BIGINT) AS n_max
    FROM readable AS runs
    CROSS JOIN (
        VALUES ('local', 'local_attempts'),
        ('peer', 'peer_helpers'),
        ('fleet', 'fleet_reassignments'),
        ('human', 'human_calls')
    ) AS counts (level, name)
),

robots AS (
    SELECT run_id, robot
    FROM fleet_members
    UNION
    SELECT run_id, robot
    FROM recovery_events
    WHERE robot IS NOT NULL
)

SELECT
    founding.run_id, robots.robot, founding.level, founding.since_seq, founding.t_max_us, founding.n_max,
    NULL::VARCHAR AS set_by
FROM founding
INNER JOIN robots ON founding.run_id = robots.run_id
UNION ALL
SELECT run_id, robot, level, seq AS since_seq, t_max_us, n_max, decided_by AS set_by
FROM recovery_budget_set
