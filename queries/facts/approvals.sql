-- Title: Reviews that a supervisor approved
-- Paper: eq:supervision, sec:model:supervision
-- Grain: one row per SupervisorResponded event that approves a review
-- Units: approved_us microseconds of run time; seq position in the run
-- NULL: approved_by when the record names no decider; a response that does not say whether it approves (NULL) does
-- Example: fsar-ledger query facts/approvals LEDGER
SELECT
    run_id,
    seq,
    time_us AS approved_us,
    action_id,
    decided_by AS approved_by
FROM supervisor_responded
WHERE purpose = 'review' AND coalesce(approves, TRUE)
