-- Title: Mean differences with intervals that treat scenarios, not runs, as the sample
-- Paper: sec:evaluation:limitations
-- Grain: one row per test (as in paired_t_tests) with pairs in 2 to 6 scenarios
-- Key: test
-- Units: mean_difference, ci_low, ci_high in the metric's unit; scenarios, samples counts. The bootstrap draws
--   scenarios with replacement, each with all its pairs; nothing is random, since all k^k ordered samples of k
--   scenarios are taken (3125 for five); 2.5 % and 97.5 % quantiles of their means
-- NULL: never; tests with one scenario or more than six are left out
-- Example: fsar-ledger query statistics/cluster_bootstrap LEDGER
WITH clusters AS (
    SELECT
        tests.test,
        sum(differences.difference_ppb)::BIGINT AS total_ppb,
        count(*) AS pairs,
        row_number() OVER (PARTITION BY tests.test ORDER BY differences.scenario) - 1 AS number,
        count(*) OVER (PARTITION BY tests.test) AS scenarios
    FROM paired_differences AS differences
    INNER JOIN paired_tests AS tests ON differences.test_id = tests.test_id
    GROUP BY tests.test, differences.scenario
),

samples AS (
    SELECT
        test, scenarios,
        unnest(range(pow(scenarios, scenarios)::BIGINT)) AS sample
    FROM clusters
    WHERE number = 0 AND scenarios BETWEEN 2 AND 6
),

draws AS (
    -- The digits of the sample's number, written in base k, are the scenarios drawn.
    SELECT
        test, scenarios, sample,
        unnest(list_transform(range(scenarios), LAMBDA place: sample // pow(scenarios, place)::BIGINT % scenarios))
            AS number
    FROM samples
),

means AS (
    SELECT
        draws.test, draws.scenarios,
        sum(clusters.total_ppb)::BIGINT / sum(clusters.pairs)::BIGINT / 1e9 AS mean
    FROM draws
    INNER JOIN clusters ON draws.test = clusters.test AND draws.number = clusters.number
    GROUP BY draws.test, draws.scenarios, draws.sample
),

intervals AS (
    SELECT
        test, scenarios,
        count(*) AS samples,
        quantile_disc(mean, 0.025) AS ci_low,
        quantile_disc(mean, 0.975) AS ci_high
    FROM means
    GROUP BY test, scenarios
),

observed AS (
    SELECT
        test,
        sum(total_ppb)::BIGINT / sum(pairs)::BIGINT / 1e9 AS mean_difference
    FROM clusters
    GROUP BY test
)

SELECT
    intervals.test, intervals.scenarios, intervals.samples, observed.mean_difference, intervals.ci_low,
    intervals.ci_high
FROM intervals
INNER JOIN observed ON intervals.test = observed.test
