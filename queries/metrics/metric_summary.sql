-- Title: Every metric over runs, with intervals
-- Paper: tab:results
-- Grain: one row per architecture, configuration, seed, setting (kind, source, model version, constants, fleet size),
--   metric, and scenario or all scenarios: runs of different ones are never in one row
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?, scenario?, metric
-- Units: as in metric_summaries
-- NULL: scenario for all scenarios; the rest as in metric_summaries
-- Example: fsar-ledger query metrics/metric_summary LEDGER
-- Summaries over the runs of all seeds are in metric_summaries.
SELECT * EXCLUDE (pools_seeds)
FROM metric_summaries
WHERE NOT pools_seeds
