-- Title: Pairwise tests, a metric that is undefined for a run counted as the paper does (containment 1, latency 0 s)
-- Paper: tab:significance
-- Grain: one row per comparison, configuration, setting (kind, source, model version, constants, fleet size), seed and
--   metric: one for every two architectures that have run, and one for each ablation
-- Key: comparison, configuration, seed?, fleet_size?, kind, source?, model_version?, constants?, metric
-- Units: first_mean, second_mean, mean_difference in the metric's unit; n pairs; the rest without unit
-- NULL: tests and effect sizes where nothing varies; McNemar columns for metrics that are not 0 or 1 per run,
--       pooled columns (pooled_tests) for metrics that are not pooled over failures
-- Example: fsar-ledger query statistics/pairwise_tests LEDGER
-- The tests over all seeds, and over the pairs in which the metric is defined for both runs, are in all_pairwise_tests.
SELECT * EXCLUDE (basis, pools_seeds)
FROM all_pairwise_tests
WHERE basis = 'published' AND NOT pools_seeds
