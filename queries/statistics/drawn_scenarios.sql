-- Title: The results of 4,000 experiments of the paper's size, drawn from these runs, for each scenario
-- Paper: sec:evaluation:ablation
-- Grain: one row per drawn experiment (drawn_sums), architecture, configuration, setting (kind, source, model version,
--   constants, fleet size), scenario and metric
-- Key: draw, architecture, configuration, setting, scenario, metric
-- Units: setting as in run_settings; value in the metric's unit
-- NULL: value where no case of the metric was drawn
-- Example: fsar-ledger query statistics/drawn_scenarios LEDGER
SELECT
    sums.draw, sums.architecture, sums.configuration, sums.fleet_size, sums.setting, sums.kind, sums.source,
    sums.model_version, sums.constants, sums.scenario, sums.position, sums.metric,
    CASE
        WHEN definitions.is_pooled
            THEN sums.numerator::DOUBLE / nullif(sums.denominator, 0)::DOUBLE / definitions.numerator_units
        ELSE sums.value_ppb::DOUBLE / nullif(sums.defined, 0) / 1e9
    END AS value
FROM drawn_sums AS sums
INNER JOIN metric_definitions AS definitions ON sums.metric = definitions.metric
