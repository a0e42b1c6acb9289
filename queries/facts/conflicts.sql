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
        action_id,
        dimension,
        claimant,
        began_us,
        coalesce(ended_us, 9223372036854775807) AS ended_us
    FROM claims
    WHERE ended_us IS NULL OR ended_us > began_us
),

clashes AS (
    SELECT
        one.run_id,
        one.action_id,
        one.dimension,
        greatest(one.began_us, other.began_us) AS began_us
    FROM held AS one
    INNER JOIN held AS other
        ON
            one.run_id = other.run_id
            AND one.action_id = other.action_id
            AND one.dimension = other.dimension
            AND one.claimant < other.claimant
            AND one.began_us < other.ended_us
            AND one.ended_us > other.began_us
)

SELECT
    run_id,
    action_id,
    dimension,
    min(began_us) AS began_us
FROM clashes
GROUP BY run_id, action_id, dimension
