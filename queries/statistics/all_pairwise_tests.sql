-- Title: All tests of all comparisons, on both bases (published: a metric that is undefined for a run counts as in the
--   paper; defined: over the pairs in which it is defined for both runs), of each seed and over all seeds
-- Paper: tab:significance
-- Grain: one row per basis, comparison, configuration, setting (kind, source, model version, constants, fleet size),
--   seed or all seeds, and metric
-- Key: basis, comparison, configuration, seed?, fleet_size?, kind, source?, model_version?, constants?, pools_seeds,
--   metric
-- Units: as in the queries that it joins
-- NULL: as in the queries that it joins; McNemar columns for metrics that are not 0 or 1 per run, pooled columns
--   (pooled_tests) for metrics that are not pooled
-- Example: fsar-ledger query statistics/all_pairwise_tests LEDGER
SELECT
    t_tests.basis, t_tests.family, t_tests.configuration, t_tests.fleet_size, t_tests.pools_seeds, t_tests.seed,
    t_tests.kind, t_tests.source, t_tests.model_version, t_tests.constants, t_tests.position, t_tests.metric,
    t_tests.comparison, t_tests.n, t_tests.first_mean, t_tests.second_mean, t_tests.mean_difference, t_tests.t,
    t_tests.df, t_tests.p, holm.p_holm, holm.family_tests, t_tests.cohens_d, t_tests.d_ci_low, t_tests.d_ci_high,
    t_tests.d_z, t_tests.hedges_g, t_tests.g_ci_low, t_tests.g_ci_high, ranks.wilcoxon_n, ranks.wilcoxon_w,
    ranks.wilcoxon_z, ranks.wilcoxon_p, mcnemar.mcnemar_first_only, mcnemar.mcnemar_second_only, mcnemar.mcnemar_p,
    pooled.first_mean AS pooled_first_mean,
    pooled.second_mean AS pooled_second_mean,
    pooled.mean_difference AS pooled_difference,
    pooled.ci_low AS pooled_ci_low,
    pooled.ci_high AS pooled_ci_high,
    pooled.pooled_test,
    pooled.p AS pooled_p,
    pooled.p_holm AS pooled_p_holm
FROM paired_t_tests AS t_tests
LEFT JOIN holm_adjustments AS holm ON t_tests.test = holm.test
LEFT JOIN wilcoxon_tests AS ranks ON t_tests.test = ranks.test
LEFT JOIN mcnemar_tests AS mcnemar ON t_tests.test = mcnemar.test
LEFT JOIN pooled_tests AS pooled ON t_tests.test = concat_ws('/', t_tests.basis, pooled.test)
