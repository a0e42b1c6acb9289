-- Title: The runs of a scenario used in each of 4,000 drawn experiments of the paper's size
-- Paper: sec:evaluation:setup
-- Grain: one row per scenario, number of its runs, drawn experiment and position of a run among them, from 0
-- Key: scenario, runs, draw, place
-- Units: runs, times counts: each draw takes as many runs as there are, with replacement, which is our sampling error,
--   and 20 of those drawn, with replacement, which is the paper's; so times add up to 20. Nothing is random: the runs
--   of a draw follow from MD5s of its number
-- NULL: never
-- Example: fsar-ledger query statistics/drawn_places LEDGER
-- Stored: every architecture, configuration and setting with the same number of runs of the scenario uses the same
--   draws
WITH counted AS (
    SELECT
        architecture, configuration, setting, scenario,
        count(DISTINCT to_json([seed, run])) AS runs
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

slots AS (
    SELECT
        experiments.draw, scenarios.scenario,
        md5_number_lower(concat_ws('/', experiments.draw, scenarios.scenario, slots.slot)) AS drawn
    FROM scenarios, range(4000) AS experiments (draw), range(20) AS slots (slot)
),

-- The position of each slot's run in the first draw; slots with the same position take the same run.
taken AS (
    SELECT
        sizes.scenario, sizes.runs, slots.draw,
        slots.drawn % sizes.runs AS position
    FROM slots
    INNER JOIN sizes ON slots.scenario = sizes.scenario
)

SELECT
    scenario, runs, draw,
    md5_number_lower(concat_ws('/', draw, scenario, 'ours', position)) % runs AS place,
    count(*) AS times
FROM taken
GROUP BY ALL
