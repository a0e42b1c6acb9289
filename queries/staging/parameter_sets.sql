-- Title: Sets of constants, and the constants in which those of one model differ
-- Paper: sec:evaluation:setup
-- Grain: one row per model (as in parameter_texts) and parameter_set
-- Key: model, parameter_set
-- Units: constants, those in which the readable sets of one model differ, as NAME=VALUE: the first five, and the number
--   of others
-- NULL: constants where all runs of the model have the same
-- Example: fsar-ledger query staging/parameter_sets LEDGER
-- A constant that a simulated run does not record has its default, if this version has one. Sets that look alike only
-- because of that are distinguished by their digests.
WITH varying AS (
    SELECT model, name
    FROM constants
    GROUP BY model, name
    HAVING count(DISTINCT value) > 1 OR count(*) < any_value(sets)
),

sets AS (
    SELECT DISTINCT
        model, parameter_set,
        values_by_name IS NOT NULL AS is_readable
    FROM parameter_texts
),

shown AS (
    SELECT
        sets.model, sets.parameter_set, varying.name,
        coalesce(constants.value, if(sets.model ->> '$[0]' = 'simulated', default_of(varying.name), NULL), 'absent')
            AS told
    FROM sets
    INNER JOIN varying ON sets.model = varying.model
    LEFT JOIN constants
        ON
            sets.model = constants.model AND sets.parameter_set = constants.parameter_set
            AND varying.name = constants.name
    WHERE sets.is_readable
    WINDOW each_name AS (PARTITION BY sets.model, varying.name)
    QUALIFY min(told) OVER each_name <> max(told) OVER each_name
),

named AS (
    SELECT
        model, parameter_set,
        list(name || '=' || told[:60] ORDER BY name) AS parts,
        bool_or(length(told) > 60) AS is_cut
    FROM shown
    GROUP BY model, parameter_set
),

differing AS (
    SELECT
        sets.model, sets.parameter_set,
        count(*) OVER (PARTITION BY sets.model) > 1 AS is_one_of_many,
        coalesce(nullif(array_to_string(named.parts[:5], ', '), ''), 'all defaults')
        || if(len(named.parts) > 5, ' and ' || (len(named.parts) - 5) || ' more', '') AS named,
        coalesce(len(named.parts) > 5 OR named.is_cut, FALSE)
        OR count(*) OVER (PARTITION BY sets.model, named.parts) > 1 AS is_short
    FROM sets
    LEFT JOIN named ON sets.model = named.model AND sets.parameter_set = named.parameter_set
    WHERE sets.is_readable
)

SELECT
    sets.model, sets.parameter_set,
    CASE
        WHEN NOT sets.is_readable THEN 'unreadable, SHA-256 ' || sets.parameter_set[12:23]
        WHEN differing.is_one_of_many
            THEN differing.named || if(differing.is_short, ' (set ' || sets.parameter_set[:8] || ')', '')
    END AS constants
FROM sets
LEFT JOIN differing ON sets.model = differing.model AND sets.parameter_set = differing.parameter_set
