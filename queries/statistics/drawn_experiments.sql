-- Title: The results of 4,000 experiments of the paper's size, drawn from these runs
-- Paper: tab:results
-- Grain: one row per drawn experiment (drawn_sums), architecture, configuration, setting (kind, source, model version,
--   constants, fleet size) and metric of the paper
-- Key: draw, architecture, configuration, setting, metric
-- Units: setting as in run_settings; value in the metric's unit
-- NULL: value where no case of the metric was drawn
-- Example: fsar-ledger query statistics/drawn_experiments LEDGER
WITH summed AS (
    SELECT
        draw, architecture, configuration, fleet_size, setting, kind, source, model_version, constants, position,
        metric,
        sum(value_ppb) AS value_ppb,
        sum(defined) AS defined,
        sum(numerator) AS numerator,
        sum(denominator) AS denominator
    FROM drawn_sums
    GROUP BY ALL
)

SELECT
    summed.draw, summed.architecture, summed.configuration, summed.fleet_size, summed.setting, summed.kind,
    summed.source, summed.model_version, summed.constants, summed.position, summed.metric,
    CASE
        WHEN definitions.is_pooled
            THEN summed.numerator::DOUBLE / nullif(summed.denominator, 0)::DOUBLE / definitions.numerator_units
        ELSE summed.value_ppb::DOUBLE / nullif(summed.defined, 0) / 1e9
    END AS value
FROM summed
INNER JOIN metric_definitions AS definitions ON summed.metric = definitions.metric
