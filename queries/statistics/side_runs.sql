-- Title: Runs of each side, with the count of each metric in them and the world they met
-- Paper: sec:evaluation:significance
-- Grain: one row per run (compared_runs) and metric
-- Key: run_id, metric
-- Units: side as in sides; value, numerator, denominator as in run_metrics; twins, observes_world, world_sha256 as in
--   compared_runs
-- NULL: as in run_metrics and compared_runs
-- Example: fsar-ledger query statistics/side_runs LEDGER
SELECT
    to_json([measured.architecture, measured.configuration, measured.setting])::VARCHAR AS side,
    measured.run_id, measured.architecture, measured.configuration, measured.setting, measured.fleet_size,
    measured.kind, measured.model_version, measured.seed, measured.scenario, measured.run, runs.twins,
    runs.observes_world, runs.world_sha256, measured.metric, measured.value, measured.numerator, measured.denominator
FROM run_metrics AS measured
INNER JOIN compared_runs AS runs ON measured.run_id = runs.run_id
