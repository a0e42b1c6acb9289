-- Title: Claims with a duration: a claim that ends when it begins is left out
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per claim (claims) that names its action, dimension and claimant
-- Key: run_id, seq
-- Units: began_us, ended_us microseconds of run time, half-open; a claim without a recorded end lasts until
--   9223372036854775807
-- NULL: never
-- Example: fsar-ledger query facts/held_claims LEDGER
SELECT
    run_id, seq, action_id, dimension, claimant, began_us,
    coalesce(ended_us, 9223372036854775807) AS ended_us
FROM claims
WHERE
    (ended_us IS NULL OR ended_us > began_us)
    AND action_id IS NOT NULL AND dimension IS NOT NULL AND claimant IS NOT NULL
