-- Title: The tests over the pairs of two architectures, or configurations, that met the same world
-- Paper: sec:evaluation:significance
-- Grain: one row per metric, comparison, configuration, setting, the pairs' seed or all seeds (pools_seeds), and basis:
--   published counts a metric that is undefined for a run as the paper does, defined leaves such pairs out
-- Key: test
-- Units: test_id a number for each; holm_family the tests that Holm adjusts together: those of the paper's metrics, or
--   of one that it does not print
-- NULL: seed for all seeds; constants as in run_settings (test names basis, comparison, setting, seed and metric in one
--   text); tests in which no run of any pair has a value of its own are left out
-- Example: fsar-ledger query statistics/paired_tests LEDGER
-- Stored: every test reads it
WITH candidates AS (
    SELECT
        pairs.comparison, pairs.family, pairs.configuration, pairs.fleet_size, scopes.pools_seeds,
        CASE WHEN NOT scopes.pools_seeds THEN pairs.seed END AS seed,
        firsts.setting, firsts.kind, firsts.source, firsts.model_version, firsts.constants, firsts.position,
        firsts.metric, definitions.is_published,
        bool_or(firsts.value IS NOT NULL AND seconds.value IS NOT NULL) AS has_defined,
        bool_or(
            (firsts.value IS NOT NULL OR seconds.value IS NOT NULL)
            AND firsts.published_convention_value IS NOT NULL AND seconds.published_convention_value IS NOT NULL
        ) AS has_published
    FROM run_pairs AS pairs
    CROSS JOIN (VALUES (FALSE), (TRUE)) AS scopes (pools_seeds)
    INNER JOIN run_metrics AS firsts ON pairs.first_run_id = firsts.run_id
    INNER JOIN run_metrics AS seconds ON pairs.second_run_id = seconds.run_id AND firsts.metric = seconds.metric
    LEFT JOIN metric_definitions AS definitions ON firsts.metric = definitions.metric
    WHERE pairs.differs IS NULL
    GROUP BY ALL
),

named AS (
    SELECT
        bases.basis, candidates.comparison, candidates.family, candidates.configuration, candidates.fleet_size,
        candidates.pools_seeds, candidates.seed, candidates.setting, candidates.kind, candidates.source,
        candidates.model_version, candidates.constants, candidates.position, candidates.metric,
        concat_ws(
            '/',
            bases.basis,
            candidates.family,
            candidates.comparison,
            candidates.setting,
            coalesce(candidates.seed::VARCHAR, 'all'),
            candidates.metric
        ) AS test,
        concat_ws(
            '/',
            bases.basis,
            candidates.family,
            candidates.setting,
            coalesce(candidates.seed::VARCHAR, 'all'),
            CASE WHEN NOT candidates.is_published THEN candidates.metric END
        ) AS holm_family
    FROM candidates
    CROSS JOIN (VALUES ('published'), ('defined')) AS bases (basis)
    WHERE if(bases.basis = 'defined', candidates.has_defined, candidates.has_published)
)

SELECT
    test, holm_family, basis, family, configuration, fleet_size, pools_seeds, seed, setting, kind, source,
    model_version, constants, position, metric, comparison,
    row_number() OVER (ORDER BY test) AS test_id
FROM named
