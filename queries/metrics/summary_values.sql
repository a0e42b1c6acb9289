-- Title: The number that each run contributes to a summary: of each scenario and of all together, of each seed and of all together
-- Paper: tab:results
-- Grain: one row per run, metric, scenario or all scenarios, and seed or all seeds (pools_seeds)
-- Key: run_id, metric, pools_seeds, scenario?
-- Units: setting and constants as in run_settings; x and pooled_mean in the metric's unit. For a pooled metric
--        x = ratio + residual / mean denominator, whose mean is the pooled ratio and sd(x) / sqrt(n) its standard error
-- NULL: scenario for all scenarios; seed for all seeds, and of runs that have none; what the run does not have; x where the metric is undefined or
--       not observable; pooled_mean for metrics that are not pooled; value_without_routine, not_observed as in run_metrics
-- Example: fsar-ledger query metrics/summary_values LEDGER
WITH scenarios AS (
    SELECT * REPLACE (NULL::VARCHAR AS scenario)
    FROM run_metrics
    UNION ALL
    SELECT *
    FROM run_metrics
    WHERE scenario IS NOT NULL
),

cells AS (
    SELECT
        scenarios.*,
        seed AS run_seed,
        FALSE AS pools_seeds
    FROM scenarios
    UNION ALL
    SELECT
        scenarios.* REPLACE (NULL::BIGINT AS seed),
        seed AS run_seed,
        TRUE AS pools_seeds
    FROM scenarios
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
    WINDOW cell AS (
        PARTITION BY cells.architecture, cells.configuration, cells.setting, cells.pools_seeds, cells.seed, cells.scenario, cells.metric
    )
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
    pools_seeds,
    seed,
    setting,
    kind,
    source,
    model_version,
    constants,
    scenario,
    position,
    metric,
    run_id,
    run_seed,
    denominator,
    value_without_routine,
    published_convention_value,
    not_observed,
    CASE WHEN is_pooled THEN (ratio + (numerator - ratio * denominator) / mean_denominator) / numerator_units ELSE value END AS x,
    CASE WHEN is_pooled THEN ratio / numerator_units END AS pooled_mean
FROM ratios
