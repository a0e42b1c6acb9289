-- Title: Authority conflicts: two or more principals hold one dimension of an action at once
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per run, action and dimension in which claims of distinct principals overlap, however many pairs
-- Units: began_us microseconds of run time, when the first overlap begins
-- NULL: never
-- Example: fsar-ledger query facts/conflicts LEDGER
WITH held AS (
    -- A claim that ends when it begins was never held.
    SELECT
        run_id,
        seq,
        action_id,
        dimension,
        claimant,
        began_us,
        coalesce(ended_us, 9223372036854775807) AS ended_us
    FROM claims
    WHERE (ended_us IS NULL OR ended_us > began_us) AND action_id IS NOT NULL AND dimension IS NOT NULL AND claimant IS NOT NULL
),

swept AS (
    -- In order of beginning, each beside the claim before it that lasts longest: where that is the claimant's own, no other can hold, or a conflict
    -- had begun before.
    SELECT
        *,
        max(ended_us) OVER earlier AS held_until_us,
        arg_max(claimant, ended_us) OVER earlier AS holder
    FROM held
    WINDOW earlier AS (PARTITION BY run_id, action_id, dimension ORDER BY began_us, seq ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING)
)

SELECT
    run_id,
    action_id,
    dimension,
    min(began_us) AS began_us
FROM swept
WHERE held_until_us > began_us AND holder <> claimant
GROUP BY run_id, action_id, dimension
