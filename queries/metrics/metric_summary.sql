-- Title: The eight metrics over runs, with intervals
-- Paper: tab:results
-- Grain: one row per architecture, configuration, fleet size, metric, and scenario or all scenarios
-- Units: mean, sd (per run), ci_low, ci_high in the metric's unit; n runs; denominator: what the metric counts, summed over runs.
--        Containment and latency are pooled: mean is the sum of numerators over the sum of denominators.
--        95 % intervals are Student's t, for human_intervention Wilson
-- NULL: scenario for all scenarios; mean where the metric is undefined in all runs; sd and Student's interval also for a single run
-- Example: fsar-ledger query metrics/metric_summary LEDGER
WITH moments AS (
    -- Sums of floats in a fixed order are the same bits on any number of threads.
    SELECT
        architecture,
        configuration,
        fleet_size,
        scenario,
        position,
        metric,
        coalesce(max(pooled_mean), avg(x ORDER BY run_id)) AS mean,
        stddev_samp(x ORDER BY run_id) AS sd,
        count(x) AS n,
        sum(denominator)::BIGINT AS denominator,
        avg(published_convention_value ORDER BY run_id) AS published_convention_mean
    FROM summary_values
    GROUP BY architecture, configuration, fleet_size, scenario, position, metric
),

quantiles AS (
    SELECT
        *,
        metric = 'human_intervention' AS is_share_of_runs,
        t_quantile(0.975, nullif(n - 1, 0)::DOUBLE) AS t,
        norm_quantile(0.975) AS z
    FROM moments
),

intervals AS (
    SELECT
        *,
        CASE WHEN is_share_of_runs THEN (mean + z * z / (2 * n)) / (1 + z * z / n) ELSE mean END AS centre,
        CASE
            WHEN is_share_of_runs THEN z * sqrt(mean * (1 - mean) / n + z * z / (4 * n * n)) / (1 + z * z / n)
            ELSE t * sd / sqrt(n)
        END AS half_width
    FROM quantiles
)

SELECT
    architecture,
    configuration,
    fleet_size,
    scenario,
    position,
    metric,
    mean,
    sd,
    n,
    centre - half_width AS ci_low,
    centre + half_width AS ci_high,
    denominator,
    published_convention_mean
FROM intervals
