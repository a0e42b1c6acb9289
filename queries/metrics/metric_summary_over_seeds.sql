-- Title: Every metric over the runs of all seeds, with intervals
-- Paper: tab:results
-- Grain: one row per architecture, configuration, setting (kind, source, model version, constants, fleet size), metric,
--   and scenario or all scenarios
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?, scenario?, metric
-- Units: as in metric_summaries
-- NULL: scenario for all scenarios; seed; the rest as in metric_summaries
-- Example: fsar-ledger query metrics/metric_summary_over_seeds LEDGER
SELECT * EXCLUDE (pools_seeds)
FROM metric_summaries
WHERE pools_seeds
