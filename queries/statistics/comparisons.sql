-- Title: Who is compared with whom: the three pairs of architectures, and an architecture with itself without a
--   mechanism
-- Paper: tab:significance, tab:ablation
-- Grain: one row per comparison and configuration; differences are first minus second
-- Key: comparison, configuration
-- Units: family names the tests that Holm adjusts together; configuration that of both architectures, of an ablation
--   the ablated one
-- NULL: never
-- Example: fsar-ledger query statistics/comparisons LEDGER
WITH pairs (comparison, first_architecture, second_architecture) AS (
    VALUES
    ('fsar-cfc', 'fsar', 'cfc'),
    ('fsar-dhma', 'fsar', 'dhma'),
    ('cfc-dhma', 'cfc', 'dhma')
),

held AS (
    SELECT DISTINCT architecture, configuration
    FROM run_metrics
    WHERE architecture IS NOT NULL AND configuration IS NOT NULL
),

shared AS (
    SELECT 'full' AS configuration
    UNION
    SELECT configuration
    FROM held
    WHERE architecture IN ('fsar', 'cfc', 'dhma')
    GROUP BY configuration
    HAVING count(*) > 1
)

SELECT
    pairs.comparison,
    CASE WHEN shared.configuration = 'full' THEN 'architectures' ELSE 'architectures ' || shared.configuration END
        AS family,
    shared.configuration, pairs.first_architecture,
    shared.configuration AS first_configuration,
    pairs.second_architecture,
    shared.configuration AS second_configuration
FROM pairs
CROSS JOIN shared
UNION ALL
SELECT
    architecture || '-' || configuration AS comparison,
    'ablations of ' || architecture AS family,
    configuration,
    architecture AS first_architecture,
    'full' AS first_configuration,
    architecture AS second_architecture,
    configuration AS second_configuration
FROM held
WHERE configuration <> 'full'
