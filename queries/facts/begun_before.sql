-- Title: Policy windows, claims and absences ended by the record of another system but begun before it; and robots that
--   it lets join again under another supervisor
-- Paper: eq:policy, eq:auth, eq:supervision
-- Grain: one row per foreign run and window closed, claim released or supervisor returned without a recorded opening,
--   claim or leaving; and per robot whose supervisor is not the same at each joining
-- Key: run_id, what, robot?, scope?, name?
-- Units: until_us microseconds of run time, when the window closes, the claim is released, the supervisor returns, or
--   the robot last joins; of a claim robot is its claimant, scope its dimension, name its action
-- NULL: robot, scope for a returning supervisor; scope, name for a robot that joins
-- Example: fsar-ledger query facts/begun_before LEDGER
SELECT
    closed.run_id, 'window' AS what, closed.robot, closed.scope, closed."window" AS name,
    min(closed.time_us) AS until_us
FROM policy_window_closed AS closed
INNER JOIN runs ON closed.run_id = runs.run_id AND runs.kind = 'foreign'
ANTI JOIN policy_window_opened AS opened
    ON
        closed.run_id = opened.run_id AND closed.robot = opened.robot AND closed.scope = opened.scope
        AND closed."window" = opened."window" AND closed.seq > opened.seq
GROUP BY ALL
UNION ALL
SELECT
    released.run_id, 'claim' AS what,
    released.claimant AS robot,
    released.dimension AS scope,
    released.action_id AS name,
    min(released.time_us) AS until_us
FROM authority_released AS released
INNER JOIN runs ON released.run_id = runs.run_id AND runs.kind = 'foreign'
ANTI JOIN authority_claimed AS claimed
    ON
        released.run_id = claimed.run_id AND released.action_id = claimed.action_id
        AND released.dimension = claimed.dimension AND released.claimant = claimed.claimant
        AND released.reason = claimed.reason AND released.seq > claimed.seq
GROUP BY ALL
UNION ALL
SELECT
    returned.run_id, 'absence' AS what,
    NULL AS robot,
    NULL AS scope,
    returned.supervisor AS name,
    min(returned.time_us) AS until_us
FROM supervisor_returned AS returned
INNER JOIN runs ON returned.run_id = runs.run_id AND runs.kind = 'foreign'
ANTI JOIN supervisor_left AS gone
    ON returned.run_id = gone.run_id AND returned.supervisor = gone.supervisor AND returned.seq > gone.seq
GROUP BY ALL
UNION ALL
-- Facts have only a robot's last supervisor (facts/fleet_members).
SELECT
    joined.run_id, 'supervisor' AS what, joined.robot,
    NULL AS scope,
    NULL AS name,
    max(joined.time_us) AS until_us
FROM robot_joined AS joined
INNER JOIN runs ON joined.run_id = runs.run_id AND runs.kind = 'foreign'
GROUP BY joined.run_id, joined.robot
HAVING count(DISTINCT coalesce(joined.supervisor, '')) > 1
