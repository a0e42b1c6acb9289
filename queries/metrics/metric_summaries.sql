-- Title: Every metric over the runs of each seed and of all seeds together, with intervals
-- Paper: tab:results
-- Grain: one row per architecture, configuration, setting (kind, source, model version, constants, fleet size), metric,
--   scenario or all scenarios, and seed or all seeds (pools_seeds)
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?, pools_seeds,
--   scenario?, metric
-- Units: mean, mean_without_routine (routine operations left out), sd (per run), ci_low, ci_high in the metric's unit;
--   n runs and their number of seeds; denominator what the metric counts, summed over runs; runs_not_observed runs that
--   do not observe what it rests on and count nowhere else. Containment and latency are pooled: mean is the sum of
--   numerators over the sum of denominators. 95 % intervals stay within the scale: Wilson for human_intervention;
--   Student's t on the logit of a share and on the logarithm of a count or time, with as many degrees of freedom as
--   runs count anything; where all agree, exact bounds for a share of 0 or 1 and for a count
-- NULL: scenario for all scenarios; seed for all seeds; dimensions that the runs lack; mean where the metric is
--   undefined or not observable in all runs, denominator where it is not observable; sd also for a single run;
--   intervals other than Wilson's where one run counts anything, and of a time or a share between 0 and 1 that does not
--   vary; mean_without_routine of a metric that counts no routine operations
-- Example: fsar-ledger query metrics/metric_summaries LEDGER
WITH moments AS (
    -- Floats summed in a fixed order give the same bits on any number of threads.
    SELECT
        architecture, configuration, fleet_size, pools_seeds, seed, kind, source, model_version, constants, scenario,
        position, metric,
        coalesce(max(pooled_mean), avg(x ORDER BY run_id)) AS mean,
        avg(value_without_routine ORDER BY run_id) AS mean_without_routine,
        stddev_samp(x ORDER BY run_id) AS sd,
        count(DISTINCT run_seed) AS seeds,
        count(x) AS n,
        count(x) FILTER (WHERE denominator IS DISTINCT FROM 0) AS telling,
        count(not_observed) AS runs_not_observed,
        sum(denominator)::BIGINT AS denominator,
        avg(published_convention_value ORDER BY run_id) AS published_convention_mean
    FROM summary_values
    GROUP BY
        architecture, configuration, fleet_size, pools_seeds, seed, setting, kind, source, model_version, constants,
        scenario, position, metric
),

quantiles AS (
    SELECT
        moments.architecture, moments.configuration, moments.fleet_size, moments.pools_seeds, moments.seed,
        moments.kind, moments.source, moments.model_version, moments.constants, moments.scenario, moments.position,
        moments.metric, moments.mean, moments.mean_without_routine, moments.sd, moments.seeds, moments.n,
        moments.telling, moments.runs_not_observed, moments.denominator, moments.published_convention_mean,
        definitions.scale,
        norm_quantile(0.975) AS z,
        moments.sd <= 1e-12 * abs(moments.mean) AS is_constant, -- apart from rounding
        t_quantile(0.975, nullif(moments.telling - 1, 0)::DOUBLE) * moments.sd / sqrt(moments.n) AS half_width,
        CASE WHEN moments.telling > 1 THEN pow(0.025, 1.0 / moments.telling) END AS agreement
    FROM moments
    INNER JOIN metric_definitions AS definitions ON moments.metric = definitions.metric
)

SELECT
    architecture, configuration, fleet_size, pools_seeds, seed, kind, source, model_version, constants, scenario,
    position, metric, mean, mean_without_routine, sd, seeds, n, runs_not_observed, denominator,
    published_convention_mean,
    CASE
        WHEN mean <= 0 THEN CASE WHEN scale = 'yes-no' OR scale <> 'seconds' AND telling > 1 THEN 0.0 END
        WHEN scale = 'yes-no'
            THEN (mean + z * z / (2 * n) - z * sqrt(mean * (1 - mean) / n + z * z / (4 * n * n))) / (1 + z * z / n)
        WHEN scale = 'share' AND mean >= 1 THEN agreement
        WHEN is_constant THEN CASE WHEN scale = 'count' THEN gamma_quantile(0.025, mean * n) / n END
        WHEN scale = 'share' THEN 1 / (1 + (1 - mean) / mean * exp(half_width / (mean * (1 - mean))))
        ELSE mean * exp(-half_width / mean)
    END AS ci_low,
    CASE
        WHEN scale IN ('share', 'yes-no') AND mean >= 1 THEN CASE WHEN scale = 'yes-no' OR telling > 1 THEN 1.0 END
        WHEN scale = 'yes-no'
            THEN (mean + z * z / (2 * n) + z * sqrt(mean * (1 - mean) / n + z * z / (4 * n * n))) / (1 + z * z / n)
        WHEN scale = 'share' AND mean <= 0 THEN 1 - agreement
        WHEN is_constant THEN CASE WHEN scale = 'count' THEN gamma_quantile(0.975, mean * n + 1) / n END
        WHEN scale = 'share' THEN 1 / (1 + (1 - mean) / mean * exp(-half_width / (mean * (1 - mean))))
        ELSE mean * exp(half_width / mean)
    END AS ci_high
FROM quantiles
