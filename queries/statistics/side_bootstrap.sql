-- Title: Bootstrap intervals of the paired differences of two sides
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of sides (side_comparisons) and metric of which at least two pairs count, over all seeds and
--   scenarios
-- Key: first_side, second_side, metric
-- Units: low, high in the metric's unit: the 2.5 % and 97.5 % quantiles of the mean contribution of pairs
--   (side_values) in 1,000 samples of as many pairs, drawn with replacement. The draws are digests of their own
--   numbers, so that the same pairs have the same interval
-- NULL: never; a metric whose contributions are not all defined is left out
-- Example: fsar-ledger query statistics/side_bootstrap LEDGER
-- Efron and Tibshirani, An Introduction to the Bootstrap, section 13.3.
WITH numbered AS (
    SELECT
        first_side, second_side, metric, contribution,
        row_number() OVER cell - 1 AS place,
        count(*) OVER (PARTITION BY first_side, second_side, metric) AS n,
        count(contribution) OVER (PARTITION BY first_side, second_side, metric) AS defined
    FROM side_values
    WHERE pools_seeds AND scenario IS NULL
    WINDOW cell AS (PARTITION BY first_side, second_side, metric ORDER BY first_run_id, second_run_id)
),

drawn AS (
    SELECT
        sizes.n, samples.sample,
        (md5_number_lower(samples.sample || '/' || draws.draw) % sizes.n)::BIGINT AS place
    FROM (
        SELECT DISTINCT n FROM numbered
        WHERE n > 1 AND defined = n
    ) AS sizes
    CROSS JOIN range(1000) AS samples (sample)
    INNER JOIN range((SELECT max(n) FROM numbered)) AS draws (draw) ON sizes.n > draws.draw
),

sums AS (
    -- Most pairs contribute nothing where few differ.
    SELECT
        numbered.first_side, numbered.second_side, numbered.metric, drawn.sample,
        sum(round(numbered.contribution * 1e9)::HUGEINT)::DOUBLE / 1e9 AS total
    FROM numbered
    INNER JOIN drawn ON numbered.n = drawn.n AND numbered.place = drawn.place
    WHERE numbered.defined = numbered.n AND numbered.contribution <> 0
    GROUP BY numbered.first_side, numbered.second_side, numbered.metric, drawn.sample
),

means AS (
    SELECT
        metrics.first_side, metrics.second_side, metrics.metric,
        coalesce(sums.total, 0) / metrics.n AS mean
    FROM (
        SELECT DISTINCT first_side, second_side, metric, n FROM numbered
        WHERE n > 1 AND defined = n
    ) AS metrics
    CROSS JOIN range(1000) AS samples (sample)
    LEFT JOIN sums
        ON
            metrics.first_side = sums.first_side AND metrics.second_side = sums.second_side
            AND metrics.metric = sums.metric AND samples.sample = sums.sample
)

SELECT
    first_side, second_side, metric,
    quantile_disc(mean, 0.025) AS low,
    quantile_disc(mean, 0.975) AS high
FROM means
GROUP BY first_side, second_side, metric
