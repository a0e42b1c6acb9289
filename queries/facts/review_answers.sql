-- Title: Supervisors' answers to reviews; the last answer for an action counts
-- Paper: eq:supervision
-- Grain: one row per SupervisorResponded event for a review of an action
-- Key: run_id, seq
-- Units: none
-- NULL: never
-- Example: fsar-ledger query facts/review_answers LEDGER
SELECT
    run_id, seq, action_id,
    coalesce(approves, TRUE) AS is_approved -- a response without a value counts as an approval
FROM supervisor_responded
WHERE purpose = 'review' AND action_id IS NOT NULL -- DuckDB before ours joins NULL to NULL in ASOF
