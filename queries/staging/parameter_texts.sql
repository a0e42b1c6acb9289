-- Title: The recorded parameters of runs, parsed by constant
-- Paper: sec:evaluation:setup
-- Grain: one row per kind, source and model version of runs (model, as JSON) and distinct text of parameters
-- Key: model, parameters
-- Units: parameter_set, equal for constants of equal values, whatever their order or spaces, 1 or 1.0; a constant
--   that is null is absent
-- NULL: values_by_name where the text cannot be read as constants
-- Example: fsar-ledger query staging/parameter_texts LEDGER
-- Stored: each text is parsed only once
WITH texts AS (
    SELECT DISTINCT
        to_json([kind, source, model_version])::VARCHAR AS model,
        parameters
    FROM run_started
    WHERE parameters IS NOT NULL
),

parsed AS MATERIALIZED (
    SELECT
        texts.model, texts.parameters,
        constants_of(parameters) AS values_by_name
    FROM texts
)

SELECT
    model, parameters, values_by_name,
    coalesce(sha256(to_json(values_by_name)::VARCHAR), 'unreadable ' || sha256(parameters)) AS parameter_set
FROM parsed
