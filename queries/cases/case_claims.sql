-- Title: The claims of the paper's four cases, and their numbers
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim, architecture, configuration, seed and setting (kind, source, model version, constants,
--   fleet size): runs of different ones are never in one row
-- Key: claim, architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?
-- Units: numerator what is counted, denominator of how many, as of_how_many says; value their ratio: a share of runs or
--   requests, conflicts per run, or events per handoff; runs of the scenario, runs_with_case those with a case,
--   runs_not_observed those for which the claim is not observable, counted nowhere else
-- NULL: value where no case arose; numerator and denominator where no run of the scenario observes what the claim rests
--   on; dimensions that the runs do not have
-- Example: fsar-ledger query cases/case_claims LEDGER
WITH judged AS (
    SELECT
        run_id, claim,
        sum(counted)::BIGINT AS numerator,
        count(*) AS denominator
    FROM case_evidence
    GROUP BY run_id, claim
),

cells AS (
    SELECT
        definitions.position, definitions.case_number, definitions.claim, definitions.is_taken, definitions.counted,
        definitions.of_how_many, runs.kind, runs.seed, runs.architecture, runs.configuration, runs.fleet_size,
        runs.model_version, runs.source, settings.setting, settings.constants, judged.numerator, judged.denominator,
        coalesce(runs.scenario = definitions.scenario AND hidden.run_id IS NULL, FALSE) AS is_judged,
        coalesce(runs.scenario = definitions.scenario AND hidden.run_id IS NOT NULL, FALSE) AS is_hidden
    FROM case_definitions AS definitions
    CROSS JOIN runs
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND definitions.judge = hidden.judge
    LEFT JOIN judged ON runs.run_id = judged.run_id AND definitions.claim = judged.claim
),

counts AS (
    SELECT
        case_number, position, claim, is_taken, counted, of_how_many, architecture, configuration, fleet_size, seed,
        kind, source, model_version, constants,
        count(*) FILTER (is_judged) AS runs,
        count(denominator) FILTER (is_judged) AS runs_with_case,
        count(*) FILTER (is_hidden) AS runs_not_observed,
        sum(numerator) FILTER (is_judged)::BIGINT AS numerator,
        sum(denominator) FILTER (is_judged)::BIGINT AS denominator
    FROM cells
    GROUP BY
        case_number, position, claim, is_taken, counted, of_how_many, architecture, configuration, fleet_size, seed,
        setting, kind, source, model_version, constants
)

SELECT
    case_number, position, claim, is_taken, counted, of_how_many, architecture, configuration, fleet_size, seed, kind,
    source, model_version, constants, runs, runs_with_case, runs_not_observed,
    CASE WHEN runs > 0 THEN coalesce(numerator, 0) END AS numerator,
    CASE WHEN runs > 0 THEN coalesce(denominator, 0) END AS denominator,
    numerator / denominator AS value
FROM counts
