-- Title: Pairs of runs that are not compared because they met different worlds, with the first difference
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of runs (run_pairs) whose worlds differ, or may differ
-- Key: comparison, configuration, first_run_id?, second_run_id?
-- Units: differs as in run_pairs; first_found and second_found give the difference for each run of the pair: for facts,
--   the first one that the other run lacks at its position, as time, type and fields; for the setting, kind, model
--   version and constants
-- NULL: first_found, second_found where a run has no more facts, or where there is nothing to show (repeated,
--   unobserved)
-- Example: fsar-ledger query statistics/differing_worlds LEDGER
WITH unlike AS (
    SELECT first_run_id, second_run_id
    FROM run_pairs
    WHERE differs = 'facts'
),

sides AS (
    SELECT
        first_run_id, second_run_id,
        unnest([first_run_id, second_run_id]) AS run_id
    FROM unlike
),

ordered AS (
    SELECT
        run_id,
        concat(time_us / 1e6, ' s ', type, ' ', fact) AS fact,
        row_number() OVER (PARTITION BY run_id ORDER BY time_us, type, fact) AS place
    FROM world_facts
    WHERE run_id IN (SELECT run_id FROM sides)
),

places AS (
    SELECT
        sides.first_run_id, sides.second_run_id, ordered.place,
        max(ordered.fact) FILTER (WHERE sides.run_id = sides.first_run_id) AS first_fact,
        max(ordered.fact) FILTER (WHERE sides.run_id = sides.second_run_id) AS second_fact
    FROM sides
    INNER JOIN ordered ON sides.run_id = ordered.run_id
    GROUP BY sides.first_run_id, sides.second_run_id, ordered.place
    HAVING first_fact IS DISTINCT FROM second_fact
),

earliest AS (
    SELECT
        first_run_id, second_run_id,
        arg_min({ 'one': first_fact, 'other': second_fact }, place) AS facts
    FROM places
    GROUP BY first_run_id, second_run_id
)

SELECT
    run_pairs.comparison, run_pairs.family, run_pairs.configuration, run_pairs.fleet_size, run_pairs.seed,
    run_pairs.scenario, run_pairs.run, run_pairs.setting, run_pairs.first_run_id, run_pairs.second_run_id,
    run_pairs.differs,
    CASE run_pairs.differs WHEN 'setting' THEN firsts.described WHEN 'facts' THEN earliest.facts.one END AS first_found,
    CASE run_pairs.differs WHEN 'setting' THEN seconds.described WHEN 'facts' THEN earliest.facts.other END
        AS second_found
FROM run_pairs
INNER JOIN compared_runs AS firsts ON run_pairs.first_run_id = firsts.run_id
INNER JOIN compared_runs AS seconds ON run_pairs.second_run_id = seconds.run_id
LEFT JOIN earliest
    ON run_pairs.first_run_id = earliest.first_run_id AND run_pairs.second_run_id = earliest.second_run_id
WHERE run_pairs.differs IS NOT NULL
