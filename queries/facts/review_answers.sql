-- Title: What supervisors answer to reviews; the last answer to an action counts
-- Paper: eq:supervision
-- Grain: one row per SupervisorResponded event for a review of an action
-- Key: run_id, seq
-- Units: none
-- NULL: never
-- Example: fsar-ledger query facts/review_answers LEDGER
SELECT
    run_id, seq, action_id,
    coalesce(approves, TRUE) AS is_approved -- a response that does not say whether it approves does
FROM supervisor_responded
WHERE purpose = 'review' AND action_id IS NOT NULL -- the DuckDB before ours joins NULL to NULL in ASOF
