-- Title: The three comparisons of two architectures
-- Paper: tab:significance
-- Grain: one row per comparison; differences are first minus second
-- Units: none
-- NULL: never
-- Example: fsar-ledger query statistics/comparisons LEDGER
WITH pairs (comparison, first_architecture, second_architecture) AS (
    VALUES
    ('fsar-cfc', 'fsar', 'cfc'),
    ('fsar-dhma', 'fsar', 'dhma'),
    ('cfc-dhma', 'cfc', 'dhma')
)

SELECT *
FROM pairs
