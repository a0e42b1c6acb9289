-- Title: The constants of runs, by name
-- Paper: sec:evaluation:setup
-- Grain: one row per model (as in parameter_texts), parameter_set and constant
-- Key: model, parameter_set, name
-- Units: value as JSON, the unit is the suffix of the name; sets, how many readable parameter sets the model has
-- NULL: never; a constant that is null or absent has no row
-- Example: fsar-ledger query staging/constants LEDGER
WITH readable AS (
    SELECT
        model, parameter_set,
        any_value(values_by_name) AS values_by_name,
        count(*) OVER (PARTITION BY model) AS sets
    FROM parameter_texts
    WHERE values_by_name IS NOT NULL
    GROUP BY model, parameter_set
),

leaves AS (
    SELECT
        model, parameter_set, sets,
        unnest(values_by_name) AS leaf
    FROM readable
)

SELECT
    model, parameter_set,
    struct_extract(leaf, 'name') AS name,
    struct_extract(leaf, 'value') AS value,
    sets
FROM leaves
