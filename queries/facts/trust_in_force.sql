-- Title: The trust in force between two robots, from each moment at which it was set
-- Paper: eq:trust
-- Grain: one row per run, robot, peer and moment of a TrustSet event; before the first there is none
-- Units: since_us, until_us microseconds of run time, half-open
-- NULL: until_us for the last row of a pair
-- Example: fsar-ledger query facts/trust_in_force LEDGER
WITH moments AS (
    -- Of several at one moment the last one holds.
    SELECT
        run_id,
        robot,
        peer,
        time_us AS since_us,
        arg_max(scope, seq) AS trust_scope
    FROM trust_set
    GROUP BY run_id, robot, peer, time_us
)

SELECT
    run_id,
    robot,
    peer,
    since_us,
    lead(since_us) OVER (PARTITION BY run_id, robot, peer ORDER BY since_us) AS until_us,
    trust_scope
FROM moments
