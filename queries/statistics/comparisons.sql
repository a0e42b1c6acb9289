-- Title: The comparisons: every two architectures, and an architecture with itself without a mechanism
-- Paper: tab:significance, tab:ablation
-- Grain: one row per comparison and configuration; differences are first minus second
-- Key: comparison, configuration
-- Units: family names the tests that Holm adjusts together: those of the paper's three architectures, and separately
--   those with any other; configuration that of both architectures, of an ablation the ablated one
-- NULL: never
-- Example: fsar-ledger query statistics/comparisons LEDGER
WITH held AS (
    SELECT DISTINCT architecture, configuration
    FROM run_metrics
    WHERE architecture IS NOT NULL AND configuration IS NOT NULL
),

of_paper (architecture, position) AS (
    VALUES ('fsar', 1), ('cfc', 2), ('dhma', 3)
),

sides AS (
    SELECT architecture, position, 'full' AS configuration
    FROM of_paper
    UNION
    SELECT held.architecture, coalesce(of_paper.position, 4) AS position, held.configuration
    FROM held
    LEFT JOIN of_paper ON held.architecture = of_paper.architecture
),

pairs AS (
    SELECT
        firsts.configuration,
        firsts.architecture AS first_architecture,
        seconds.architecture AS second_architecture,
        CASE WHEN seconds.position < 4 THEN 'architectures' ELSE 'architectures added' END AS family
    FROM sides AS firsts
    INNER JOIN sides AS seconds
        ON
            firsts.configuration = seconds.configuration
            AND (firsts.position, firsts.architecture) < (seconds.position, seconds.architecture)
    LEFT JOIN held
        ON firsts.architecture = held.architecture AND firsts.configuration = held.configuration
    -- The paper's pairs are included even without runs; others only where there are runs.
    WHERE seconds.position < 4 OR held.architecture IS NOT NULL
)

SELECT
    first_architecture || '-' || second_architecture AS comparison,
    CASE WHEN configuration = 'full' THEN family ELSE family || ' ' || configuration END AS family,
    configuration, first_architecture,
    configuration AS first_configuration,
    second_architecture,
    configuration AS second_configuration
FROM pairs
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
