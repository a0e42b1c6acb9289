-- Title: Runs, and which of them may be counted together
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Key: run_id
-- Units: made_alike, equal for runs of one architecture, configuration, seed and setting (kind, source, model
--   version, constants, fleet size); fleet_size robots; constants as in parameter_sets
-- NULL: dimensions that the run lacks; constants where all runs of the kind and model have the same
-- Example: fsar-ledger query staging/run_groups LEDGER
SELECT
    runs.run_id,
    to_json([runs.architecture, runs.configuration, runs.seed::VARCHAR, settings.setting])::VARCHAR AS made_alike,
    runs.architecture, runs.configuration, runs.fleet_size, runs.seed, settings.kind, runs.source, runs.model_version,
    settings.constants
FROM runs
INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
