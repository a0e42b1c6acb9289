-- Title: Pairs of runs of two sides with the same seed, scenario and number, what they share, and why a pair is left
--   out
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of sides (side_comparisons) and pair of such runs; sides of different fleet sizes are paired
--   without it
-- Key: first_side, second_side, first_run_id?, second_run_id?
-- Units: shares is what both met: facts (the world did the same), draws (one model under other constants or with other
--   robots: what was drawn for the same subject is the same), seed (only seed, scenario and number; their draws are not
--   comparable). differs is why a pair is left out: repeated (a run has a twin), unobserved (one of them does not
--   observe the facts of the world), facts (other facts under the same setting)
-- NULL: shares of a pair that is left out, differs of one that is not
-- Example: fsar-ledger query statistics/side_pairs LEDGER
WITH each_run AS (
    SELECT DISTINCT
        side, run_id, setting, kind, model_version, seed, scenario, run, twins, observes_world,
        coalesce(world_sha256, '') AS world
    FROM side_runs
),

candidates AS (
    SELECT
        comparisons.first_side, comparisons.second_side, firsts.seed, firsts.scenario, firsts.run,
        firsts.run_id AS first_run_id,
        seconds.run_id AS second_run_id,
        firsts.world = seconds.world AS is_same_world,
        firsts.kind = 'simulated'
        AND seconds.kind = 'simulated'
        AND firsts.model_version = seconds.model_version AS is_same_model,
        CASE
            WHEN greatest(firsts.twins, seconds.twins) > 1 THEN 'repeated'
            WHEN NOT (firsts.observes_world AND seconds.observes_world) THEN 'unobserved'
            WHEN firsts.setting = seconds.setting AND firsts.world <> seconds.world THEN 'facts'
        END AS differs
    FROM side_comparisons AS comparisons
    INNER JOIN each_run AS firsts ON comparisons.first_side = firsts.side
    INNER JOIN each_run AS seconds
        ON
            comparisons.second_side = seconds.side AND firsts.seed = seconds.seed AND firsts.scenario = seconds.scenario
            AND firsts.run = seconds.run
)

SELECT
    first_side, second_side, seed, scenario, run, first_run_id, second_run_id, differs,
    CASE
        WHEN differs IS NULL THEN CASE WHEN is_same_world THEN 'facts' WHEN is_same_model THEN 'draws' ELSE 'seed' END
    END AS shares
FROM candidates
