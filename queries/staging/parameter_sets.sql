-- Title: Sets of constants, and the constants in which those of one model differ
-- Paper: sec:evaluation:setup
-- Grain: one row per model (as in parameter_texts) and parameter_set
-- Units: constants, those in which the readable sets of one model differ, as NAME=VALUE: the first five, and how many more
-- NULL: constants where all runs of the model have the same
-- Example: fsar-ledger query staging/parameter_sets LEDGER
WITH varying AS (
    SELECT
        model,
        name
    FROM constants
    GROUP BY model, name
    HAVING count(DISTINCT value) > 1 OR count(*) < any_value(sets)
),

sets AS (
    SELECT DISTINCT
        model,
        parameter_set,
        values_by_name IS NOT NULL AS is_readable
    FROM parameter_texts
),

differing AS (
    SELECT
        sets.model,
        sets.parameter_set,
        list(varying.name || '=' || coalesce(constants.value[:60], 'absent') ORDER BY varying.name) AS named,
        coalesce(bool_or(length(constants.value) > 60), FALSE) AS is_cut
    FROM sets
    INNER JOIN varying ON sets.model = varying.model
    LEFT JOIN constants ON sets.model = constants.model AND sets.parameter_set = constants.parameter_set AND varying.name = constants.name
    WHERE sets.is_readable
    GROUP BY sets.model, sets.parameter_set
)

SELECT
    sets.model,
    sets.parameter_set,
    CASE
        WHEN NOT sets.is_readable THEN 'unreadable, SHA-256 ' || sets.parameter_set[12:23]
        ELSE
            array_to_string(differing.named[:5], ', ')
            || CASE WHEN len(differing.named) > 5 THEN ' and ' || (len(differing.named) - 5) || ' more' ELSE '' END
            || CASE WHEN len(differing.named) > 5 OR differing.is_cut THEN ' (set ' || sets.parameter_set[:8] || ')' ELSE '' END
    END AS constants
FROM sets
LEFT JOIN differing ON sets.model = differing.model AND sets.parameter_set = differing.parameter_set
