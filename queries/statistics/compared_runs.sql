-- Title: Runs with a seed, a scenario and a number, which may share their world with another run
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Key: run_id
-- Units: setting as in run_settings, described its kind, source, model version and constants; twins runs of the same
--   architecture, configuration, setting, seed, scenario and number, including the run itself; observes_world whether
--   its source records every fact of the world
-- NULL: world_sha256 of a run without facts of the world
-- Example: fsar-ledger query statistics/compared_runs LEDGER
-- Stored: every pair reads it twice
WITH found AS (
    SELECT DISTINCT
        run_id, architecture, configuration, fleet_size, seed, scenario, run, setting,
        concat_ws(', ', kind, source, 'model ' || model_version, constants) AS described,
        list_has_all(observes, ['policy', 'task', 'supervision', 'world']) AS observes_world
    FROM run_metrics
    WHERE seed IS NOT NULL AND scenario IS NOT NULL AND run IS NOT NULL AND fleet_size IS NOT NULL
)

SELECT
    found.run_id, found.architecture, found.configuration, found.fleet_size, found.seed, found.scenario, found.run,
    found.setting, found.described, found.observes_world, digests.world_sha256,
    count(*)
        OVER (
            PARTITION BY found.architecture, found.configuration, found.setting, found.seed, found.scenario, found.run
        )
        AS twins
FROM found
LEFT JOIN world_digests AS digests ON found.run_id = digests.run_id
