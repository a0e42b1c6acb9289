-- Title: Every metric over runs, with the dials that the paper leaves open
-- Paper: tab:ablation
-- Grain: one row per architecture, configuration, setting (kind, source, model version, constants, fleet size), metric,
--   scenario or all scenarios, and seed or all seeds (pools_seeds), as in metric_summaries
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?, pools_seeds,
--   scenario?, metric
-- Units: as in metric_summaries; setting, encounter_mean_s, teams_working and made_alike_but as in dials
-- NULL: as in metric_summaries and dials
-- Example: fsar-ledger query metrics/metrics_by_dial LEDGER
SELECT
    summaries.architecture, summaries.configuration, summaries.fleet_size, summaries.pools_seeds, summaries.seed,
    summaries.kind, summaries.source, summaries.model_version, summaries.constants, summaries.scenario,
    summaries.position, summaries.metric, summaries.mean, summaries.mean_without_routine, summaries.sd, summaries.seeds,
    summaries.n, summaries.runs_not_observed, summaries.denominator, summaries.published_convention_mean,
    summaries.ci_low, summaries.ci_high, dials.setting, dials.encounter_mean_s, dials.teams_working,
    dials.made_alike_but
FROM metric_summaries AS summaries
INNER JOIN dials
    ON
        summaries.kind = dials.kind AND summaries.source IS NOT DISTINCT FROM dials.source
        AND summaries.model_version IS NOT DISTINCT FROM dials.model_version
        AND summaries.constants IS NOT DISTINCT FROM dials.constants
        AND summaries.fleet_size IS NOT DISTINCT FROM dials.fleet_size
