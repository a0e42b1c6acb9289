-- Title: Planned runs, and how many the ledger holds
-- Paper: sec:evaluation:setup
-- Grain: one row per plan
-- Key: plan
-- Units: planned_count, there_count, missing_count runs; larger_plans how many plans of the ledger name all runs of
--   this one and more
-- NULL: never
-- Example: fsar-ledger query audit/experiments LEDGER
--   answers plan.n4.s42.x0020-...: 300 planned, 300 there, 0 missing, part of 0 larger plans
-- A plan that is part of a larger one was enlarged. The ledger then holds the same runs as if the larger one had been
-- planned at once, under another root.
WITH there AS (
    SELECT
        plan,
        count(DISTINCT row(architecture, configuration, scenario, run)) AS there_count
    FROM planned_runs
    GROUP BY plan
),

larger AS (
    SELECT
        plans.plan,
        count(*) AS larger_plans
    FROM plans
    INNER JOIN plans AS others
        ON
            plans.seed = others.seed AND plans.fleet_size = others.fleet_size
            AND plans.model_version = others.model_version AND plans.parameters_sha256 = others.parameters_sha256
    WHERE
        plans.planned_count < others.planned_count AND others.first_run <= plans.first_run
        AND plans.first_run::HUGEINT + plans.run_count <= others.first_run::HUGEINT + others.run_count
        AND list_has_all(others.architectures, plans.architectures)
        AND list_has_all(others.configurations, plans.configurations)
        AND list_has_all(others.scenarios, plans.scenarios)
    GROUP BY plans.plan
)

SELECT
    plans.plan, plans.seed, plans.fleet_size, plans.architectures, plans.configurations, plans.scenarios,
    plans.first_run, plans.run_count, plans.model_version, plans.parameters_sha256, plans.planned_count,
    coalesce(there.there_count, 0) AS there_count,
    plans.planned_count - coalesce(there.there_count, 0) AS missing_count,
    coalesce(larger.larger_plans, 0) AS larger_plans
FROM plans
LEFT JOIN there ON plans.plan = there.plan
LEFT JOIN larger ON plans.plan = larger.plan
