-- Title: A digest of what the world did in each run
-- Paper: sec:evaluation:setup
-- Grain: one row per run with at least one fact of the world
-- Key: run_id
-- Units: world_sha256, equal for the same facts at the same times, regardless of the order of simultaneous facts and of
--   everything else that the run records
-- NULL: never
-- Example: fsar-ledger query statistics/world_digests LEDGER
-- Partial: the rows of a run do not depend on other runs
SELECT
    run_id,
    sha256(string_agg(sha256(time_us || ' ' || type || ' ' || fact), '' ORDER BY time_us, type, fact)) AS world_sha256
FROM world_facts
GROUP BY run_id
