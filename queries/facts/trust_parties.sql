-- Title: The robots on either side of each entry of trust
-- Paper: eq:trust
-- Grain: one row per TrustSet, RoleTrustSet or InitialTrustSet event, side and robot; an entry about roles or all
--   robots has one for each member, including later members
-- Key: run_id, seq, is_trusting, robot
-- Units: joined_us microseconds of run time at which the robot became a member; 0 where no record says when
-- NULL: never; is_trusting: the robot is one that trusts, else one that is trusted
-- Example: fsar-ledger query facts/trust_parties LEDGER
-- An entry applies to a pair when one robot is on its trusting side and the other on its trusted side, so pairs need
-- no rows of their own.
-- Initial trust has the robot on its side, and all others on the other.
SELECT
    pairs.run_id, pairs.seq, pairs.is_trusting, pairs.robot,
    coalesce(members.joined_us, 0) AS joined_us
FROM (
    SELECT
        run_id, seq,
        unnest([TRUE, FALSE]) AS is_trusting,
        unnest([robot, peer]) AS robot
    FROM trust_set
) AS pairs
LEFT JOIN fleet_members AS members ON pairs.run_id = members.run_id AND pairs.robot = members.robot
UNION ALL
SELECT entries.run_id, entries.seq, sides.is_trusting, members.robot, members.joined_us
FROM role_trust_set AS entries
CROSS JOIN (VALUES (TRUE), (FALSE)) AS sides (is_trusting)
INNER JOIN fleet_members AS members
    ON
        entries.run_id = members.run_id
        AND CASE WHEN sides.is_trusting THEN entries.role ELSE entries.peer_role END = members.role
WHERE entries.domain IN ('', coalesce(members.domain, '')) OR starts_with(members.domain, entries.domain || '/')
UNION ALL
SELECT
    joined.run_id, joined.seq,
    (joined.robot = members.robot) = joined.is_trusting AS is_trusting,
    members.robot, members.joined_us
FROM initial_trust_set AS joined
INNER JOIN fleet_members AS members ON joined.run_id = members.run_id
