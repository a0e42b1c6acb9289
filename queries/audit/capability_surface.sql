-- Title: The capability surface of a robot at a time: what it offers, who may discover it, who may ask for it
-- Paper: eq:advertise, eq:delegable
-- Grain: one row per run, robot and capability that it had advertised by then
-- Units: since_us, at_us microseconds of run time; the default time is after the end of every run
-- NULL: never; visible_to is empty when every role may discover it, may_ask when nobody has both the role and the robot's trust
-- Example: fsar-ledger query audit/capability_surface LEDGER --param run=RUN --param robot=robot/C1 --param at_us=30000000
--   answers inspect.private_zone: discoverable by role B, and robot/B1 may ask for it
-- Parameters: run = all, robot = all, at_us = 9007199254740991
WITH offers AS (
    -- Of several advertisements of a capability the last one holds.
    SELECT
        run_id,
        robot,
        capability,
        arg_max(time_us, seq) AS since_us,
        arg_max(visible_to, seq) AS visible_to
    FROM capability_advertised
    WHERE $run IN ('all', run_id) AND $robot IN ('all', robot) AND time_us <= $at_us::BIGINT
    GROUP BY run_id, robot, capability
),

trusted AS (
    SELECT
        trust.run_id,
        trust.robot,
        trust.peer,
        members.role
    FROM trust_in_force AS trust
    INNER JOIN robot_joined AS members ON trust.run_id = members.run_id AND trust.peer = members.robot
    WHERE
        trust.trust_scope <> 'none'
        AND members.time_us <= $at_us::BIGINT
        AND trust.since_us <= $at_us::BIGINT
        AND (trust.until_us IS NULL OR trust.until_us > $at_us::BIGINT)
)

SELECT
    offers.run_id,
    offers.robot,
    offers.capability,
    offers.since_us,
    offers.visible_to,
    coalesce(list(DISTINCT trusted.peer ORDER BY trusted.peer) FILTER (WHERE trusted.peer IS NOT NULL), []) AS may_ask
FROM offers
LEFT JOIN trusted
    ON
        offers.run_id = trusted.run_id
        AND offers.robot = trusted.robot
        AND (len(offers.visible_to) = 0 OR list_contains(offers.visible_to, trusted.role))
GROUP BY offers.run_id, offers.robot, offers.capability, offers.since_us, offers.visible_to
