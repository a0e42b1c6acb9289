-- Title: Paired differences of two sides, metric by metric, with intervals and tests
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of sides (side_comparisons), metric, seed or all seeds (pools_seeds), and scenario or all
--   scenarios
-- Key: first_side, second_side, pools_seeds, seed?, scenario?, metric
-- Units: means and counts of pairs as in side_moments. 95 % interval: Student's t with differing_pairs - 1 degrees of
--   freedom; of human_intervention after Bonett and Price. test is paired t, or sign (exact, of the pairs that differ):
--   for human_intervention, where one pair differs, where fewer than 25 and less than half do, and where all differ
--   alike. p_holm over the family_tests tests of the same sides, seed and scenario, or of all scenarios' rows, for the
--   paper's metrics together and each other one by itself. d_z in standard deviations of the pairs' contributions
-- NULL: seed for all seeds; scenario for all scenarios; means as in side_moments; the interval where fewer than two
--   pairs differ, where they differ alike, or where a side counts only one pair; test, p where no pair differs; d_z
--   where nothing varies
-- Example: fsar-ledger query statistics/side_differences LEDGER
WITH tested AS (
    SELECT
        moments.first_side, moments.second_side, moments.pools_seeds, moments.seed, moments.scenario, moments.metric,
        moments.n, moments.differing_pairs, moments.first_mean, moments.second_mean, moments.mean_difference,
        moments.sd, definitions.position,
        CASE WHEN NOT definitions.is_published THEN moments.metric END AS further,
        norm_quantile(0.975) AS z,
        (moments.above + 1) / (moments.n + 2) AS more,
        (moments.below + 1) / (moments.n + 2) AS less,
        definitions.scale = 'yes-no'
        OR moments.error IS NULL
        OR moments.differing_pairs < greatest(2, least(25, moments.n / 2)) AS is_counted,
        if(definitions.scale = 'yes-no', more - less, moments.mean_difference) AS middle,
        if(
            scale = 'yes-no',
            z * sqrt((more + less - (more - less) * (more - less)) / (moments.n + 2)),
            t_quantile(0.975, CASE WHEN differing_pairs > 1 THEN differing_pairs - 1 END::DOUBLE) * moments.error
        ) AS half,
        if(definitions.scale IN ('share', 'yes-no'), 1.0::DOUBLE, 'infinity'::DOUBLE) AS most,
        CASE
            WHEN above + below > 0 AND moments.mean_difference IS NOT NULL THEN if(is_counted, 'sign', 'paired t')
        END AS test,
        CASE
            WHEN test IS NULL THEN NULL
            WHEN is_counted THEN binomial_half_sf2(least(above, below), above + below)
            ELSE t_sf2(moments.mean_difference / moments.error, (differing_pairs - 1)::DOUBLE)
        END AS p
    FROM side_moments AS moments
    INNER JOIN metric_definitions AS definitions ON moments.metric = definitions.metric
),

ranked AS (
    SELECT
        first_side, second_side, pools_seeds, seed, scenario, metric, n, differing_pairs, first_mean, second_mean,
        mean_difference, sd, position, further, middle, half, most, test, p,
        count(p) OVER family AS family_tests,
        (count(p) OVER family - row_number() OVER (family ORDER BY p NULLS LAST, scenario, position) + 1) * p AS bound
    FROM tested
    WINDOW family AS (PARTITION BY first_side, second_side, pools_seeds, seed, scenario IS NULL, further)
)

SELECT
    first_side, second_side, pools_seeds, seed, scenario, position, metric, n, differing_pairs, first_mean, second_mean,
    mean_difference, test, p, family_tests,
    mean_difference / sd AS d_z,
    CASE WHEN half IS NOT NULL THEN greatest(middle - half, -most) END AS ci_low,
    CASE WHEN half IS NOT NULL THEN least(middle + half, most) END AS ci_high,
    CASE
        WHEN p IS NOT NULL
            THEN
                least(
                    1,
                    max(bound)
                        OVER (
                            PARTITION BY first_side, second_side, pools_seeds, seed, scenario IS NULL, further
                            ORDER BY p NULLS LAST, scenario, position
                        )
                )
    END AS p_holm
FROM ranked
