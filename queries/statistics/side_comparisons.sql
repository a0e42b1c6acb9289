-- Title: The compared sides: those of the paper's comparisons under one setting; `compare` replaces them with its two
-- Paper: tab:significance, tab:ablation
-- Grain: one row per comparison, configuration and setting
-- Key: comparison, configuration, setting
-- Units: comparison, family, configuration as in comparisons; first_side, second_side as in sides
-- NULL: never
-- Example: fsar-ledger query statistics/side_comparisons LEDGER
WITH held AS (
    SELECT DISTINCT side, architecture, configuration, setting
    FROM side_runs
)

SELECT
    comparisons.comparison, comparisons.family, comparisons.configuration, firsts.setting,
    firsts.side AS first_side,
    seconds.side AS second_side
FROM comparisons
INNER JOIN held AS firsts
    ON comparisons.first_architecture = firsts.architecture AND comparisons.first_configuration = firsts.configuration
INNER JOIN held AS seconds
    ON
        comparisons.second_architecture = seconds.architecture
        AND comparisons.second_configuration = seconds.configuration AND firsts.setting = seconds.setting
