-- Title: The trust in force at a time
-- Paper: eq:trust
-- Grain: one row per run and ordered pair of robots for which trust had been set by then
-- Units: since_us, until_us, at_us microseconds of run time, half-open; the default time is after the end of every run
-- NULL: until_us when it was not set again; a pair without a row had no trust
-- Example: fsar-ledger query audit/trust_at LEDGER --param run=RUN --param robot=robot/B1 --param peer=robot/A1 --param at_us=30000000
--   answers robot/B1 trusts robot/A1 with scope task since 0
-- Parameters: run = all, robot = all, peer = all, at_us = 9007199254740991
SELECT
    run_id,
    robot,
    peer,
    trust_scope,
    since_us,
    until_us
FROM trust_in_force
WHERE
    $run IN ('all', run_id)
    AND $robot IN ('all', robot)
    AND $peer IN ('all', peer)
    AND since_us <= $at_us::BIGINT
    AND (until_us IS NULL OR until_us > $at_us::BIGINT)
