-- Title: The runs of a scenario that each of 4,000 drawn experiments of the paper's size takes
-- Paper: sec:evaluation:setup
-- Grain: one row per scenario, count of its runs, drawn experiment and place of a run among them, from 0
-- Key: scenario, runs, draw, place
-- Units: runs, times counts: for each draw, as many runs as there are are drawn from these with replacement, which is
--   our sampling error, and from what was drawn 20 with replacement, which is the paper's; so times add up to 20.
--   Nothing is random: which runs a draw takes follows from MD5s of its number
-- NULL: none
-- Example: fsar-ledger query statistics/drawn_places LEDGER
-- Stored: every architecture, configuration and setting with as many runs of the scenario is drawn alike
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

-- Which of the runs that were drawn first each slot takes; two slots that take the same one take the same run.
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
