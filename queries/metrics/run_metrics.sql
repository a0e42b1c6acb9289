-- Title: The metrics of every run
-- Paper: sec:evaluation:metrics
-- Grain: one row per run and metric
-- Key: run_id, metric
-- Units: setting and constants as in run_settings; value share, count or seconds, as the metric says; numerator and
--   denominator as in the metric's own query; value_without_routine the same without routine operations, where the
--   metric counts them
-- NULL: value where the metric is undefined for the run; published_convention_value then has the paper's value
--   (containment 1, latency 0 s), else NULL; value_without_routine where the metric counts no routine operations, and
--   where it counts only these; all numbers where the run does not observe what the metric rests on, which not_observed
--   names and is NULL otherwise
-- Example: fsar-ledger query metrics/run_metrics LEDGER
-- Stored: the summaries and every statistic read it several times
SELECT
    runs.run_id, settings.kind, runs.observes, runs.seed, runs.architecture, runs.configuration, runs.scenario,
    runs.fleet_size, runs.run, runs.model_version, runs.parameters_sha256, runs.source, settings.setting,
    settings.constants, definitions.position, measured.metric, measured.value, measured.numerator, measured.denominator,
    measured.value_without_routine,
    CASE WHEN measured.not_observed IS NULL THEN coalesce(measured.value, definitions.published_value) END
        AS published_convention_value,
    measured.not_observed
FROM runs
INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
INNER JOIN metric_measurements AS measured ON runs.run_id = measured.run_id
INNER JOIN metric_definitions AS definitions ON measured.metric = definitions.metric
