-- Title: The number that each run contributes to a summary, for each scenario and for all together
-- Paper: tab:results
-- Grain: one row per run, metric, and scenario or all scenarios
-- Units: x and pooled_mean in the metric's unit. For a pooled metric
--        x = ratio + residual / mean denominator, whose mean is the pooled ratio and sd(x) / sqrt(n) its standard error
-- NULL: scenario for all scenarios; x where the metric is undefined or not observable; pooled_mean for metrics that are not pooled; not_observed where
--       the run observes what the metric rests on; value_without_routine as in run_metrics
-- Example: fsar-ledger query metrics/summary_values LEDGER
WITH cells AS (
    SELECT * REPLACE (NULL::VARCHAR AS scenario)
    FROM run_metrics
    UNION ALL
    SELECT *
    FROM run_metrics
    WHERE scenario IS NOT NULL
),

scaled AS (
    SELECT
        cells.*,
        definitions.is_pooled,
        definitions.numerator_units,
        sum(cells.numerator) OVER cell AS numerators,
        sum(cells.denominator) OVER cell AS denominators,
        count(cells.denominator) OVER cell AS runs
    FROM cells
    INNER JOIN metric_definitions AS definitions ON cells.metric = definitions.metric
    WINDOW cell AS (PARTITION BY cells.architecture, cells.configuration, cells.fleet_size, cells.scenario, cells.metric)
),

ratios AS (
    SELECT
        *,
        numerators::DOUBLE / nullif(denominators::DOUBLE, 0) AS ratio,
        nullif(denominators::DOUBLE, 0) / runs AS mean_denominator
    FROM scaled
)

SELECT
    architecture,
    configuration,
    fleet_size,
    scenario,
    position,
    metric,
    run_id,
    denominator,
    value_without_routine,
    published_convention_value,
    not_observed,
    CASE WHEN is_pooled THEN (ratio + (numerator - ratio * denominator) / mean_denominator) / numerator_units ELSE value END AS x,
    CASE WHEN is_pooled THEN ratio / numerator_units END AS pooled_mean
FROM ratios
