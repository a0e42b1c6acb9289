-- Title: Containment and latency are means over all runs; one without a failure counts as 1.0 and as 0 s
-- Paper: tab:significance
-- Reading: R5
-- Question: how failures of several runs are combined
-- Replaces: metric_definitions
-- Moves: recovery_containment, reassignment_latency_s
-- Why: All tests have 100 pairs, also where few runs fail; 1.0 and 0 s for the others fit the printed tests.
-- Grain: one row per metric
-- Key: metric
-- Units: as in metric_definitions
-- NULL: as in metric_definitions
-- Example: fsar-ledger query readings/published_convention LEDGER
SELECT
    * REPLACE (
        is_pooled AND metric NOT IN ('recovery_containment', 'reassignment_latency_s') AS is_pooled,
        CASE
            WHEN metric IN ('recovery_containment', 'reassignment_latency_s') THEN published_value ELSE undefined_value
        END AS undefined_value
    )
FROM metric_definitions
