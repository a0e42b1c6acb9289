-- Title: The effect sizes of 4,000 experiments of the paper's size, drawn from these runs
-- Paper: tab:significance
-- Grain: one row per drawn experiment (drawn_places), comparison of two full architectures, setting (kind, source,
--   model version, constants, fleet size) and metric of the paper; draws are from the pairs of all seeds together
-- Key: draw, comparison, fleet_size, kind, source?, model_version?, constants?, metric
-- Units: cohens_d in pooled standard deviations, with sign, as in paired_t_tests, over the n drawn pairs (20 of each
--   scenario, those of a world drawn together for all comparisons), a metric that is undefined for a run counted as
--   the paper does. Sums are of integers, billionths of the metric's unit
-- NULL: cohens_d where neither side varies. Scenarios in which fewer pairs than runs met the same world are not drawn
-- Example: fsar-ledger query statistics/drawn_effects LEDGER
WITH numbered AS (
    SELECT
        tests.test, tests.comparison, tests.configuration, tests.fleet_size, tests.kind, tests.source,
        tests.model_version, tests.constants, tests.position, tests.metric, pairs.scenario,
        dense_rank() OVER (PARTITION BY tests.test, pairs.scenario ORDER BY pairs.seed, pairs.run) - 1 AS place,
        round(pairs.first_value * 1e9)::HUGEINT AS first_ppb,
        round(pairs.second_value * 1e9)::HUGEINT AS second_ppb
    FROM paired_tests AS tests
    INNER JOIN metric_definitions AS definitions ON tests.metric = definitions.metric AND definitions.is_published
    INNER JOIN paired_differences AS pairs ON tests.test_id = pairs.test_id
    WHERE tests.basis = 'published' AND tests.pools_seeds AND tests.family = 'architectures'
),

counted AS (
    SELECT
        test, scenario,
        max(place) + 1 AS runs
    FROM numbered
    GROUP BY test, scenario
),

picked AS (
    SELECT
        counted.test, counted.scenario, places.draw, places.place,
        places.times::HUGEINT AS times
    FROM drawn_places AS places
    INNER JOIN counted ON places.scenario = counted.scenario AND places.runs = counted.runs
),

summed AS (
    SELECT
        picked.draw, numbered.comparison, numbered.configuration, numbered.fleet_size, numbered.kind, numbered.source,
        numbered.model_version, numbered.constants, numbered.position, numbered.metric,
        sum(picked.times) AS n,
        sum(picked.times * numbered.first_ppb) AS first_sum,
        sum(picked.times * numbered.second_ppb) AS second_sum,
        sum(picked.times * numbered.first_ppb * numbered.first_ppb) AS first_squares,
        sum(picked.times * numbered.second_ppb * numbered.second_ppb) AS second_squares
    FROM picked
    INNER JOIN numbered
        ON
            picked.test = numbered.test AND picked.scenario = numbered.scenario AND picked.place = numbered.place
    GROUP BY ALL
)

SELECT
    draw, comparison, configuration, fleet_size, kind, source, model_version, constants, position, metric,
    n::BIGINT AS n,
    (first_sum - second_sum)::DOUBLE / n::DOUBLE / sqrt(
        nullif(n * (first_squares + second_squares) - first_sum * first_sum - second_sum * second_sum, 0)::DOUBLE
        / (2 * n * (n - 1))::DOUBLE
    ) AS cohens_d
FROM summed
