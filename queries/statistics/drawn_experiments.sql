-- Title: What experiments of the paper's size would have printed: 4,000 of them, drawn from the runs that are here
-- Paper: tab:results
-- Grain: one row per drawn experiment, architecture, configuration, setting (kind, source, model version, constants, fleet size), seed and metric
-- Units: setting as in run_settings; value in the metric's unit. An experiment is 20 runs of each scenario, drawn as in drawn_scenarios
-- NULL: value where nothing that the metric counts was drawn
-- Example: fsar-ledger query statistics/drawn_experiments LEDGER
WITH summed AS (
    SELECT
        draw,
        architecture,
        configuration,
        fleet_size,
        setting,
        seed,
        kind,
        source,
        model_version,
        constants,
        position,
        metric,
        sum(value_sum)::DOUBLE / nullif(sum(valued), 0) / 1e9 AS mean,
        sum(numerators)::DOUBLE / nullif(sum(denominators), 0)::DOUBLE AS ratio
    FROM drawn_scenarios
    GROUP BY draw, architecture, configuration, fleet_size, setting, seed, kind, source, model_version, constants, position, metric
)

SELECT
    summed.* EXCLUDE (mean, ratio),
    if(definitions.is_pooled, summed.ratio / definitions.numerator_units, summed.mean) AS value
FROM summed
INNER JOIN metric_definitions AS definitions ON summed.metric = definitions.metric
