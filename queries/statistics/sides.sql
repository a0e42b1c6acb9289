-- Title: Sides that can be compared: runs that differ only in seed, scenario and number
-- Paper: sec:evaluation:significance
-- Grain: one row per architecture, configuration and setting (kind, source, model version, constants, fleet size)
-- Key: side
-- Units: side names the row in one text; made_as as kind in run_settings; run_count runs, named_count those with seed,
--   scenario and number, which a pair needs; seeds, scenarios of these
-- NULL: dimensions that the runs lack
-- Example: fsar-ledger query statistics/sides LEDGER
SELECT
    to_json([runs.architecture, runs.configuration, settings.setting])::VARCHAR AS side,
    runs.architecture, runs.configuration, runs.fleet_size, runs.kind,
    settings.kind AS made_as,
    runs.source, runs.model_version, settings.setting, settings.parameter_set,
    count(*) AS run_count,
    count(*) FILTER (
        WHERE runs.seed IS NOT NULL
        AND runs.scenario IS NOT NULL
        AND runs.run IS NOT NULL
        AND runs.fleet_size IS NOT NULL
    ) AS named_count,
    list_sort(list_distinct(list(runs.seed))) AS seeds,
    list_sort(list_distinct(list(runs.scenario))) AS scenarios
FROM runs
INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
GROUP BY
    runs.architecture, runs.configuration, runs.fleet_size, runs.kind, settings.kind, runs.source, runs.model_version,
    settings.setting, settings.parameter_set
