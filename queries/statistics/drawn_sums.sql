-- Title: The sums over each scenario in 4,000 experiments of the paper's size, drawn from these runs
-- Paper: sec:evaluation:setup
-- Grain: one row per drawn experiment, architecture, configuration, setting (kind, source, model version, constants,
--   fleet size), scenario and metric of the paper; draws are from the runs of all seeds together
-- Key: draw, architecture, configuration, setting, scenario, metric
-- Units: setting as in run_settings; value_ppb billionths of the metric's unit, summed over defined runs; numerator,
--   denominator as in run_metrics, summed. 20 runs of the scenario are drawn with replacement; the runs of a world are
--   drawn together for all architectures. Nothing is random: the runs of a draw follow from an MD5 of its number
--   (drawn_places)
-- NULL: value_ppb, defined, numerator, denominator where no drawn run has one
-- Example: fsar-ledger query statistics/drawn_sums LEDGER
WITH numbered AS (
    SELECT
        runs.kind, runs.architecture, runs.configuration, runs.scenario, runs.fleet_size, runs.model_version,
        runs.source, runs.setting, runs.constants, runs.position, runs.metric, runs.value, runs.numerator,
        runs.denominator,
        dense_rank() OVER (
            PARTITION BY runs.architecture, runs.configuration, runs.setting, runs.scenario
            ORDER BY runs.seed, runs.run
        ) - 1 AS place
    FROM run_metrics AS runs
    INNER JOIN metric_definitions AS definitions ON runs.metric = definitions.metric AND definitions.is_published
    WHERE
        runs.not_observed IS NULL AND runs.architecture IS NOT NULL AND runs.scenario IS NOT NULL
        AND runs.run IS NOT NULL
),

counted AS (
    SELECT
        architecture, configuration, setting, scenario,
        max(place) + 1 AS runs
    FROM numbered
    GROUP BY ALL
),

picked AS (
    SELECT
        counted.architecture, counted.configuration, counted.setting, counted.scenario, places.draw, places.place,
        places.times
    FROM drawn_places AS places
    INNER JOIN counted ON places.scenario = counted.scenario AND places.runs = counted.runs
)

SELECT
    picked.draw, numbered.architecture, numbered.configuration, numbered.fleet_size, numbered.setting, numbered.kind,
    numbered.source, numbered.model_version, numbered.constants, numbered.scenario, numbered.position, numbered.metric,
    sum(picked.times * round(numbered.value * 1e9)::BIGINT) AS value_ppb,
    sum(picked.times) FILTER (WHERE numbered.value IS NOT NULL) AS defined,
    sum(picked.times * numbered.numerator) AS numerator,
    sum(picked.times * numbered.denominator) AS denominator
FROM picked
INNER JOIN numbered
    ON
        picked.architecture = numbered.architecture AND picked.configuration = numbered.configuration
        AND picked.setting = numbered.setting AND picked.scenario = numbered.scenario AND picked.place = numbered.place
GROUP BY ALL
