-- Title: Paired t-tests with effect sizes
-- Paper: tab:significance
-- Grain: one row per test (basis, comparison, configuration, setting, seed or all seeds, metric) with at least one pair
-- Key: test
-- Units: means and mean_difference in the metric's unit; cohens_d in pooled standard deviations (as published, with
--   sign), d_z in standard deviations of the differences; hedges_g = J * cohens_d with J = 1 - 3 / (4 df - 1). 95 %
--   intervals of both from the variance of d for correlated pairs by the delta method: var(differences) / (n s^2) + d^2
--   (s1^4 + s2^4 + 2 cov^2) / (8 df s^4), s the pooled standard deviation
-- NULL: t, p, d_z when all differences are equal (or one pair); cohens_d, hedges_g when neither side varies; hedges_g
--   also for two pairs, where J is 0; the intervals also for two pairs, and when one side does not vary, or both do
--   alike (r = 1)
-- Example: fsar-ledger query statistics/paired_t_tests LEDGER
WITH moments AS (
    SELECT
        test_id,
        count(*) AS n,
        min(difference_ppb) < max(difference_ppb) AS differences_vary,
        avg(first_value ORDER BY pair) AS first_mean,
        avg(second_value ORDER BY pair) AS second_mean,
        avg(difference ORDER BY pair) AS mean_difference,
        stddev_samp(first_value ORDER BY pair) AS first_sd,
        stddev_samp(second_value ORDER BY pair) AS second_sd,
        stddev_samp(difference ORDER BY pair) AS difference_sd
    FROM paired_differences
    GROUP BY test_id
),

sizes AS (
    SELECT
        test_id, n, first_mean, second_mean, mean_difference,
        n - 1 AS df,
        CASE WHEN differences_vary THEN mean_difference / difference_sd END AS d_z,
        sqrt((first_sd * first_sd + second_sd * second_sd) / 2) AS pooled_sd,
        (first_sd * first_sd + second_sd * second_sd - difference_sd * difference_sd) / 2 AS covariance,
        covariance / nullif(first_sd * second_sd, 0) AS r,
        CASE WHEN pooled_sd > 1e-12 THEN mean_difference / pooled_sd END AS cohens_d,
        CASE WHEN df > 1 THEN 1 - 3.0::DOUBLE / (4 * df - 1) END AS correction,
        pow(difference_sd / pooled_sd, 2) / n AS variance_of_difference,
        pow(cohens_d, 2) * (pow(first_sd, 4) + pow(second_sd, 4) + 2 * pow(covariance, 2))
        / (8 * df * pow(pooled_sd, 4)) AS variance_of_spread,
        CASE
            WHEN r < 1 - 1e-9 AND correction IS NOT NULL
                THEN norm_quantile(0.975) * sqrt(variance_of_difference + variance_of_spread)
        END AS half_width
    FROM moments
)

SELECT
    tests.test, tests.holm_family, tests.basis, tests.family, tests.configuration, tests.fleet_size, tests.pools_seeds,
    tests.seed, tests.kind, tests.source, tests.model_version, tests.constants, tests.position, tests.metric,
    tests.comparison, sizes.n, sizes.first_mean, sizes.second_mean, sizes.mean_difference, sizes.df, sizes.d_z,
    sizes.cohens_d,
    sizes.d_z * sqrt(sizes.n) AS t,
    t_sf2(sizes.d_z * sqrt(sizes.n), sizes.df::DOUBLE) AS p,
    sizes.cohens_d - sizes.half_width AS d_ci_low,
    sizes.cohens_d + sizes.half_width AS d_ci_high,
    sizes.correction * sizes.cohens_d AS hedges_g,
    sizes.correction * (sizes.cohens_d - sizes.half_width) AS g_ci_low,
    sizes.correction * (sizes.cohens_d + sizes.half_width) AS g_ci_high
FROM sizes
INNER JOIN paired_tests AS tests ON sizes.test_id = tests.test_id
