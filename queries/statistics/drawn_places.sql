-- Title: The runs of a scenario that each of 4,000 drawn experiments of the paper's size takes
-- Paper: sec:evaluation:setup
-- Grain: one row per scenario, count of its runs, drawn experiment and place of a run among them, from 0
-- Key: scenario, runs, draw, place
-- Units: runs, times counts: 20 runs are drawn with replacement, so times add up to 20. Nothing is random: which runs a
--   draw takes follows from an MD5 of its number
-- NULL: none
-- Example: fsar-ledger query statistics/drawn_places LEDGER
-- Stored: every architecture, configuration and setting with as many runs of the scenario is drawn alike
WITH counted AS (
    SELECT
        architecture, configuration, setting, seed, scenario,
        count(DISTINCT run) AS runs
    FROM run_metrics
    WHERE not_observed IS NULL AND architecture IS NOT NULL AND scenario IS NOT NULL AND run IS NOT NULL
    GROUP BY ALL
),

sizes AS (
    SELECT DISTINCT scenario, runs
    FROM counted
),

scenarios AS (
    SELECT DISTINCT scenario
    FROM counted
),

draws AS (
    SELECT
        experiments.draw, scenarios.scenario,
        md5_number_lower(concat_ws('/', experiments.draw, scenarios.scenario, slots.slot)) AS drawn
    FROM scenarios, range(4000) AS experiments (draw), range(20) AS slots (slot)
)

SELECT
    sizes.scenario, sizes.runs, draws.draw,
    draws.drawn % sizes.runs AS place,
    count(*) AS times
FROM draws
INNER JOIN sizes ON draws.scenario = sizes.scenario
GROUP BY ALL
