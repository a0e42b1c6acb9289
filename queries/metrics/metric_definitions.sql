-- Title: The eight metrics: their order, their scale, which way is better, how runs are pooled, and what the paper
--   counts where nothing happened
-- Paper: sec:evaluation:metrics
-- Grain: one row per metric
-- Key: metric
-- Units: numerator_units, how many units of the numerator make one of the value; scale is share, count, seconds, or
--   yes-no (0 or 1 for each run); better is higher or lower; undefined_value, what a run counts as in which a metric
--   that is not pooled is undefined
-- NULL: published_value when the metric is defined for every run; undefined_value where such a run does not count, as
--   with us always
-- Example: fsar-ledger query metrics/metric_definitions LEDGER
WITH definitions (position, metric, scale, better, is_pooled, numerator_units, published_value, undefined_value) AS (
    VALUES
    (1, 'coordination_success', 'share', 'higher', FALSE, 1, NULL::DOUBLE, NULL::DOUBLE),
    (2, 'governance_locality', 'share', 'higher', FALSE, 1, NULL, NULL),
    (3, 'recovery_containment', 'share', 'higher', TRUE, 1, 1.0, NULL),
    (4, 'authority_conflicts', 'count', 'lower', FALSE, 1, NULL, NULL),
    (5, 'policy_violations', 'count', 'lower', FALSE, 1, NULL, NULL),
    (6, 'reassignment_latency_s', 'seconds', 'lower', TRUE, 1000000, 0.0, NULL),
    (7, 'human_intervention', 'yes-no', 'lower', FALSE, 1, NULL, NULL),
    (8, 'audit_attributability', 'share', 'higher', FALSE, 1, NULL, NULL)
)

SELECT *
FROM definitions
