-- Title: What each run contributes to the summaries: of its scenario and of all, of its seed and of all
-- Paper: tab:results
-- Grain: one row per run, metric, scenario or all scenarios, and seed or all seeds (pools_seeds)
-- Key: run_id, metric, pools_seeds, scenario?
-- Units: setting and constants as in run_settings; x and pooled_mean in the metric's unit. For a pooled metric
--        x = ratio + residual / mean denominator, whose mean is the pooled ratio and sd(x) / sqrt(n) its standard error
-- NULL: scenario for all scenarios; seed for all seeds, and of runs that have none; dimensions that the run lacks; x
--   where the metric is undefined or not observable; pooled_mean for metrics that are not pooled;
--   value_without_routine, not_observed as in run_metrics
-- Example: fsar-ledger query metrics/summary_values LEDGER
WITH cells AS (
    SELECT
        runs.architecture, runs.configuration, runs.fleet_size, scopes.pools_seeds,
        CASE WHEN NOT scopes.pools_seeds THEN runs.seed END AS seed,
        runs.setting, runs.kind, runs.source, runs.model_version, runs.constants,
        CASE WHEN scopes.is_of_scenario THEN runs.scenario END AS scenario,
        runs.position, runs.metric, runs.run_id,
        runs.seed AS run_seed,
        runs.value, runs.numerator, runs.denominator, runs.value_without_routine, runs.published_convention_value,
        runs.not_observed
    FROM run_metrics AS runs
    INNER JOIN
        (VALUES (FALSE, FALSE), (FALSE, TRUE), (TRUE, FALSE), (TRUE, TRUE)) AS scopes (pools_seeds, is_of_scenario)
        ON NOT scopes.is_of_scenario OR runs.scenario IS NOT NULL
),

ratios AS (
    SELECT
        cells.architecture, cells.configuration, cells.fleet_size, cells.pools_seeds, cells.seed, cells.setting,
        cells.kind, cells.source, cells.model_version, cells.constants, cells.scenario, cells.position, cells.metric,
        cells.run_id, cells.run_seed, cells.value, cells.numerator, cells.denominator, cells.value_without_routine,
        cells.published_convention_value, cells.not_observed, definitions.is_pooled, definitions.numerator_units,
        (sum(cells.numerator) OVER cell)::DOUBLE / nullif((sum(cells.denominator) OVER cell)::DOUBLE, 0) AS ratio,
        nullif((sum(cells.denominator) OVER cell)::DOUBLE, 0) / count(cells.denominator) OVER cell AS mean_denominator
    FROM cells
    INNER JOIN metric_definitions AS definitions ON cells.metric = definitions.metric
    WINDOW cell AS (
        PARTITION BY
            cells.architecture, cells.configuration, cells.setting, cells.pools_seeds, cells.seed, cells.scenario,
            cells.metric
    )
)

SELECT
    architecture, configuration, fleet_size, pools_seeds, seed, setting, kind, source, model_version, constants,
    scenario, position, metric, run_id, run_seed, denominator, value_without_routine, published_convention_value,
    not_observed,
    CASE
        WHEN is_pooled THEN (ratio + (numerator - ratio * denominator) / mean_denominator) / numerator_units ELSE value
    END AS x,
    CASE WHEN is_pooled THEN ratio / numerator_units END AS pooled_mean
FROM ratios
