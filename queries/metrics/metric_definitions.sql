-- Title: The eight metrics: their order, their scale, how runs are pooled, and what the paper counts where nothing happened
-- Paper: sec:evaluation:metrics
-- Grain: one row per metric
-- Units: numerator_units, how many units of the numerator make one of the value; scale is share, count, seconds, or yes-no (0 or 1 for each run)
-- NULL: published_value when the metric is defined for every run
-- Example: fsar-ledger query metrics/metric_definitions LEDGER
WITH definitions (position, metric, scale, is_pooled, numerator_units, published_value) AS (
    VALUES
    (1, 'coordination_success', 'share', FALSE, 1, NULL::DOUBLE),
    (2, 'governance_locality', 'share', FALSE, 1, NULL),
    (3, 'recovery_containment', 'share', TRUE, 1, 1.0),
    (4, 'authority_conflicts', 'count', FALSE, 1, NULL),
    (5, 'policy_violations', 'count', FALSE, 1, NULL),
    (6, 'reassignment_latency_s', 'seconds', TRUE, 1000000, 0.0),
    (7, 'human_intervention', 'yes-no', FALSE, 1, NULL),
    (8, 'audit_attributability', 'share', FALSE, 1, NULL)
)

SELECT *
FROM definitions
