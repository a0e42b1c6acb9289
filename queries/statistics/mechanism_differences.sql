-- Title: The effect of each mechanism on each metric: an architecture in full and without it, in pairs
-- Paper: sec:evaluation:ablation
-- Grain: one row per architecture, configuration that lacks one mechanism, setting (kind, source, model version,
--   constants, fleet size), metric, and seed or all seeds (pools_seeds)
-- Key: architecture, configuration, setting, seed?, pools_seeds, metric
-- Units: first is in full and second without, so mean_difference is what the mechanism adds; n and all other columns as
--   in side_differences, except p_holm, over the family_tests tests of all mechanisms of all architectures, of one
--   setting and seed, for the paper's metrics together and each other one by itself
-- NULL: seed for all seeds; the rest as in side_differences
-- Example: fsar-ledger query statistics/mechanism_differences LEDGER
WITH ablated AS (
    SELECT
        sides.architecture, comparisons.configuration, sides.setting, sides.fleet_size, sides.kind, sides.source,
        sides.model_version, differences.pools_seeds, differences.seed, differences.position, differences.metric,
        CASE WHEN NOT definitions.is_published THEN differences.metric END AS further,
        differences.n, differences.differing_pairs,
        differences.first_mean AS full_mean,
        differences.second_mean AS without_mean,
        differences.mean_difference, differences.ci_low, differences.ci_high, differences.test, differences.p,
        differences.d_z
    FROM side_differences AS differences
    INNER JOIN side_comparisons AS comparisons
        ON differences.first_side = comparisons.first_side AND differences.second_side = comparisons.second_side
    INNER JOIN sides ON differences.second_side = sides.side
    INNER JOIN metric_definitions AS definitions ON differences.metric = definitions.metric
    WHERE
        comparisons.family LIKE 'ablations of %' AND comparisons.configuration NOT LIKE '%+%'
        AND differences.scenario IS NULL
),

ranked AS (
    SELECT
        architecture, configuration, setting, fleet_size, kind, source, model_version, pools_seeds, seed, position,
        further, metric, n, differing_pairs, full_mean, without_mean, mean_difference, ci_low, ci_high, test, p, d_z,
        count(p) OVER family AS family_tests,
        (
            count(p) OVER family
            - row_number() OVER (family ORDER BY p NULLS LAST, architecture, configuration, position)
            + 1
        )
        * p AS bound
    FROM ablated
    WINDOW family AS (PARTITION BY setting, pools_seeds, seed, further)
)

SELECT
    architecture, configuration, setting, fleet_size, kind, source, model_version, pools_seeds, seed, position, metric,
    n, differing_pairs, full_mean, without_mean, mean_difference, ci_low, ci_high, test, p, d_z, family_tests,
    CASE
        WHEN p IS NOT NULL
            THEN
                least(
                    1,
                    max(bound)
                        OVER (
                            PARTITION BY setting, pools_seeds, seed, further
                            ORDER BY p NULLS LAST, architecture, configuration, position
                        )
                )
    END AS p_holm
FROM ranked
