-- Title: The values of the dials that the paper leaves open, by setting
-- Paper: tab:scaling
-- Grain: one row per setting (kind, source, model version, constants, fleet size)
-- Key: setting
-- Units: setting and kind as in run_settings; encounter_mean_s in s; teams_working teams, all of the fleet's unless
--   the runs record otherwise; made_alike_but, equal for settings of one kind, source and model that differ only in
--   fleet size and these two dials
-- NULL: source, model_version, constants and fleet_size as in run_groups; a dial of a source that records none and has
--   no default
-- Example: fsar-ledger query staging/dials LEDGER
-- A constant that a simulated run does not record has its default, if this version has one.
WITH settings AS (
    SELECT DISTINCT
        run_settings.kind, run_started.source, run_started.model_version, run_started.fleet_size, run_settings.setting,
        run_settings.constants, run_settings.parameter_set,
        to_json([run_started.kind, run_started.source, run_started.model_version])::VARCHAR AS model
    FROM run_started
    INNER JOIN run_settings ON run_started.run_id = run_settings.run_id
),

by_set AS (
    SELECT
        model, parameter_set,
        any_value(value) FILTER (WHERE name = 'world.encounter_mean_s') AS encounter_mean_s,
        any_value(value) FILTER (WHERE name = 'load.teams_working') AS teams_working,
        count(*) FILTER (WHERE regexp_full_match(name, 'fleet\.robots\[\d+\]\.name')) AS robots_of_team,
        list(name || '=' || value ORDER BY name) FILTER (
            WHERE
            name NOT IN ('world.encounter_mean_s', 'load.teams_working')
            AND (model ->> '$[0]' <> 'simulated' OR value IS DISTINCT FROM default_of(name))
        ) AS others
    FROM constants
    GROUP BY model, parameter_set
)

SELECT
    settings.setting, settings.kind, settings.source, settings.model_version, settings.constants, settings.fleet_size,
    coalesce(
        try_cast(by_set.encounter_mean_s AS DOUBLE),
        if(settings.model ->> '$[0]' = 'simulated', try_cast(default_of('world.encounter_mean_s') AS DOUBLE), NULL)
    ) AS encounter_mean_s,
    coalesce(
        try_cast(by_set.teams_working AS BIGINT),
        settings.fleet_size // coalesce(nullif(by_set.robots_of_team, 0), 4)
    ) AS teams_working,
    sha256(
        to_json(
            [
                if(settings.kind = 'fork', settings.setting, settings.kind), -- forks are alike only in one setting
                settings.model,
                if(by_set.model IS NULL, settings.parameter_set, NULL),
                to_json(by_set.others)::VARCHAR
            ]
        )::VARCHAR
    ) AS made_alike_but
FROM settings
LEFT JOIN by_set ON settings.model = by_set.model AND settings.parameter_set = by_set.parameter_set
