-- Title: What the world did in each run, as one digest
-- Paper: sec:evaluation:setup
-- Grain: one row per run with at least one fact of the world
-- Key: run_id
-- Units: world_sha256, equal for the same facts at the same times, whatever the order of simultaneous facts and
--   whatever else the run records
-- NULL: never
-- Example: fsar-ledger query statistics/world_digests LEDGER
-- Partial: what it says of a run does not depend on others
SELECT
    run_id,
    sha256(string_agg(sha256(time_us || ' ' || type || ' ' || fact), '' ORDER BY time_us, type, fact)) AS world_sha256
FROM world_facts
GROUP BY run_id
