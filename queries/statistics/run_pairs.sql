-- Title: Pairs of runs of two architectures or configurations with the same seed, scenario, fleet size and number, and
--   how their worlds differ
-- Paper: sec:evaluation:significance
-- Grain: one row per comparison, configuration and pair of such runs: both under the same setting, or one that has no
--   counterpart under its own setting
-- Key: comparison, configuration, first_run_id?, second_run_id?
-- Units: differs is why a pair is not compared: setting (kind, source, model version or constants), repeated (a run has
--   a twin, so the pair is ambiguous), unobserved (one of them does not observe the facts of the world), facts (the
--   facts of the world differ)
-- NULL: differs where both met the same world
-- Example: fsar-ledger query statistics/run_pairs LEDGER
-- Stored: every test reads it
WITH candidates AS (
    SELECT
        comparisons.comparison, comparisons.family, comparisons.configuration, firsts.fleet_size, firsts.seed,
        firsts.scenario, firsts.run, firsts.setting,
        firsts.run_id AS first_run_id,
        seconds.run_id AS second_run_id,
        firsts.setting = seconds.setting AS is_same_setting,
        greatest(firsts.twins, seconds.twins) > 1 AS is_repeated,
        firsts.observes_world AND seconds.observes_world AS is_observed,
        coalesce(firsts.world_sha256, '') = coalesce(seconds.world_sha256, '') AS is_same_world,
        bool_or(firsts.setting = seconds.setting)
            OVER (PARTITION BY comparisons.comparison, comparisons.configuration, firsts.run_id)
            AS first_has_own,
        bool_or(firsts.setting = seconds.setting)
            OVER (PARTITION BY comparisons.comparison, comparisons.configuration, seconds.run_id)
            AS second_has_own
    FROM comparisons
    INNER JOIN compared_runs AS firsts
        ON
            comparisons.first_architecture = firsts.architecture
            AND comparisons.first_configuration = firsts.configuration
    INNER JOIN compared_runs AS seconds
        ON
            comparisons.second_architecture = seconds.architecture
            AND comparisons.second_configuration = seconds.configuration AND firsts.fleet_size = seconds.fleet_size
            AND firsts.seed = seconds.seed AND firsts.scenario = seconds.scenario AND firsts.run = seconds.run
)

SELECT
    comparison, family, configuration, fleet_size, seed, scenario, run, setting, first_run_id, second_run_id,
    CASE
        WHEN NOT is_same_setting THEN 'setting'
        WHEN is_repeated THEN 'repeated'
        WHEN NOT is_observed THEN 'unobserved'
        WHEN NOT is_same_world THEN 'facts'
    END AS differs
FROM candidates
WHERE is_same_setting OR NOT first_has_own OR NOT second_has_own
