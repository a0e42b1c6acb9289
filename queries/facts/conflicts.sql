-- Title: Authority conflicts: two or more principals hold the same dimension of an action at once
-- Paper: sec:evaluation:metrics (authority conflict)
-- Grain: one row per run, action and dimension in which claims of distinct principals overlap, however many pairs
-- Key: run_id, action_id, dimension
-- Units: began_us microseconds of run time, when the first overlap begins
-- NULL: never
-- Example: fsar-ledger query facts/conflicts LEDGER
WITH swept AS (
    -- Ordered by beginning, each claim beside the earlier one that lasts longest. If both have the same claimant,
    -- either no other claim holds or a conflict has begun before.
    SELECT
        run_id, action_id, dimension, claimant, began_us,
        max(ended_us) OVER earlier AS held_until_us,
        arg_max(claimant, ended_us) OVER earlier AS holder
    FROM held_claims
    WINDOW
        earlier AS (
            PARTITION BY run_id, action_id, dimension
            ORDER BY began_us, seq ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
        )
)

SELECT
    run_id, action_id, dimension,
    min(began_us) AS began_us
FROM swept
WHERE held_until_us > began_us AND holder <> claimant
GROUP BY run_id, action_id, dimension
