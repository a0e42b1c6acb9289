-- Title: Policy windows, claims and absences that the record of another system ends, and that began before it; and
--   robots that it lets join again under another supervisor than before
-- Paper: eq:policy, eq:auth, eq:supervision
-- Grain: one row per foreign run and window that closes, claim that is released, or supervisor who returns, without
--   having opened, been made or left; and per robot whose supervisor is not the same each time that it joins
-- Key: run_id, what, robot?, scope?, name?
-- Units: until_us microseconds of run time, when the window closes, the claim is released, the supervisor returns, or
--   the robot joins last; of a claim robot is its claimant, scope its dimension, name its action
-- NULL: robot, scope for a supervisor who returns; scope, name for one of a robot that joins
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
-- Facts know a robot's last supervisor alone (facts/fleet_members).
SELECT
    joined.run_id, 'supervisor' AS what, joined.robot,
    NULL AS scope,
    NULL AS name,
    max(joined.time_us) AS until_us
FROM robot_joined AS joined
INNER JOIN runs ON joined.run_id = runs.run_id AND runs.kind = 'foreign'
GROUP BY joined.run_id, joined.robot
HAVING count(DISTINCT coalesce(joined.supervisor, '')) > 1
