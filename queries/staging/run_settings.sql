-- Title: The setting of each run: kind, source, model, constants and fleet size
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Key: run_id
-- Units: kind of run, workflow for simulated runs of the paper's workflows, which are not runs of a scenario, fork for
--   runs that fork from another one; setting, equal for runs of the same kind, source, model version, constants by
--   value, fleet size and changes; parameter_set, constants as in parameter_sets, and then the changes of a fork
-- NULL: parameter_set of runs that record no parameters; constants where the runs of the same kind, source and model
--   version have the same, or none, and nothing is changed
-- Example: fsar-ledger query staging/run_settings LEDGER
-- Stored: every metric and comparison reads it
WITH started AS (
    SELECT
        run_id,
        CASE
            WHEN changes IS NOT NULL THEN 'fork'
            WHEN kind = 'simulated' AND starts_with(scenario, 'workflow-') THEN 'workflow'
            ELSE kind
        END AS kind,
        to_json([kind, source, model_version])::VARCHAR AS model,
        parameters, fleet_size, changes
    FROM run_started
)

SELECT
    started.run_id, started.kind,
    sha256(
        to_json(
            [
                if(started.kind IN ('workflow', 'fork'), started.kind || ' ', '') || started.model,
                sets.parameter_set,
                started.fleet_size::VARCHAR
            ]
            || coalesce(started.changes, [])
        )::VARCHAR
    ) AS setting,
    texts.parameter_set,
    CASE
        WHEN started.changes IS NULL THEN sets.constants
        ELSE concat_ws('; ', sets.constants, coalesce(nullif(array_to_string(started.changes, '; '), ''), 'no change'))
    END AS constants
FROM started
LEFT JOIN parameter_texts AS texts ON started.model = texts.model AND started.parameters = texts.parameters
LEFT JOIN parameter_sets AS sets ON texts.model = sets.model AND texts.parameter_set = sets.parameter_set
