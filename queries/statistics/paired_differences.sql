-- Title: Differences between two architectures, or configurations, that met the same world
-- Paper: sec:evaluation:significance
-- Grain: one row per metric, pair of runs that met the same world (run_pairs), basis, and the pair's seed or all seeds
--   (pools_seeds): published counts a metric that is undefined for a run as the paper does, defined leaves such pairs
--   out
-- Key: test, first_run_id, second_run_id
-- Units: first_value, second_value, difference (first minus second) in the metric's unit; difference_ppb billionths of
--   it, an integer so that differences which are equal but for the last bits of a float tie in ranks; holm_family the
--   tests that Holm adjusts together: those of the paper's metrics, or of one that it does not print
-- NULL: seed for all seeds; constants as in run_settings (test names basis, comparison, setting, seed and metric in one
--   text); pairs with an undefined value are left out, and tests in which no run of any pair has a value of its own
-- Example: fsar-ledger query statistics/paired_differences LEDGER
-- Stored: every test reads it
WITH seeds AS (
    SELECT
        run_pairs.comparison, run_pairs.family, run_pairs.configuration, run_pairs.fleet_size, scopes.pools_seeds,
        CASE WHEN NOT scopes.pools_seeds THEN run_pairs.seed END AS seed,
        run_pairs.scenario, run_pairs.run, run_pairs.first_run_id, run_pairs.second_run_id
    FROM run_pairs
    CROSS JOIN (VALUES (FALSE), (TRUE)) AS scopes (pools_seeds)
    WHERE run_pairs.differs IS NULL
),

measured AS (
    SELECT
        run_id, kind, source, model_version, constants, setting, position, metric, value,
        'published' AS basis,
        published_convention_value AS tested_value
    FROM run_metrics
    UNION ALL
    SELECT
        run_id, kind, source, model_version, constants, setting, position, metric, value,
        'defined' AS basis,
        value AS tested_value
    FROM run_metrics
)

SELECT
    concat_ws(
        '/',
        firsts.basis,
        seeds.family,
        seeds.comparison,
        firsts.setting,
        coalesce(seeds.seed::VARCHAR, 'all'),
        firsts.metric
    ) AS test,
    concat_ws(
        '/',
        firsts.basis,
        seeds.family,
        firsts.setting,
        coalesce(seeds.seed::VARCHAR, 'all'),
        CASE WHEN NOT definitions.is_published THEN firsts.metric END
    ) AS holm_family,
    firsts.basis, seeds.family, seeds.configuration, seeds.fleet_size, seeds.pools_seeds, seeds.seed, firsts.kind,
    firsts.source, firsts.model_version, firsts.constants, firsts.position, firsts.metric, seeds.comparison,
    seeds.scenario, seeds.run, seeds.first_run_id, seeds.second_run_id,
    firsts.tested_value AS first_value,
    seconds.tested_value AS second_value,
    firsts.tested_value - seconds.tested_value AS difference,
    round((firsts.tested_value - seconds.tested_value) * 1e9)::BIGINT AS difference_ppb
FROM seeds
INNER JOIN measured AS firsts ON seeds.first_run_id = firsts.run_id
INNER JOIN measured AS seconds
    ON seeds.second_run_id = seconds.run_id AND firsts.basis = seconds.basis AND firsts.metric = seconds.metric
LEFT JOIN metric_definitions AS definitions ON firsts.metric = definitions.metric
WHERE firsts.tested_value IS NOT NULL AND seconds.tested_value IS NOT NULL
QUALIFY bool_or(firsts.value IS NOT NULL OR seconds.value IS NOT NULL) OVER (PARTITION BY test)
