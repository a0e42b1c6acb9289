-- Title: Runs and the plans that name them
-- Paper: sec:evaluation:setup
-- Grain: one row per plan and run of the ledger that it names
-- Key: plan, run_id
-- Units: none
-- NULL: never
-- Example: fsar-ledger query facts/planned_runs LEDGER
-- Runs that no plan names are left out: those that were not simulated, and those of ledgers from before plans were
-- recorded.
SELECT plans.plan, runs.run_id, runs.architecture, runs.configuration, runs.scenario, runs.run
FROM plans
INNER JOIN runs
    ON
        plans.seed = runs.seed AND plans.fleet_size = runs.fleet_size
        AND plans.model_version = runs.model_version AND plans.parameters_sha256 = runs.parameters_sha256
WHERE
    runs.kind = 'simulated' AND runs.forked_from IS NULL AND runs.run >= 0 AND runs.run >= plans.first_run
    AND runs.run < plans.first_run::HUGEINT + plans.run_count
    AND list_contains(plans.architectures, runs.architecture)
    AND list_contains(plans.configurations, runs.configuration) AND list_contains(plans.scenarios, runs.scenario)
