-- Title: The reasons of refusals that are the same in every run, and the part of admissibility that each denies
-- Paper: eq:admissible
-- Grain: one row per reason
-- Key: reason
-- Units: none
-- NULL: conjunct when the refusal is no part of eq:admissible
-- Example: fsar-ledger query facts/refusal_reasons LEDGER
WITH reasons (reason, conjunct) AS (
    VALUES
    ('possession', 'possession'),
    ('advertisement', 'advertisement'),
    ('trust', 'trust'),
    ('no trust', 'trust'),
    ('permission', 'trust'),
    ('policy', 'policy'),
    ('local-policy', 'policy'),
    ('fleet-rule', 'policy'),
    ('review', 'policy'),
    ('local-execution', 'local-execution'),
    ('authority', 'authority'),
    ('negotiation', 'authority'),
    ('override', 'authority'),
    ('no candidate', NULL),
    ('no answer', NULL),
    ('no channel', NULL),
    ('helper declined', NULL)
)

SELECT
    reason, conjunct
FROM reasons
