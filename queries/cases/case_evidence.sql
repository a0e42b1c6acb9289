-- Title: The four cases, item by item: each request, run or handoff, and whether it counts
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim and item whose outcome is on record, as in case_1_evidence to case_4_evidence
-- Key: run_id, claim, seq
-- Units: counted how much the item adds to the numerator; seq the event with which it began, evidence the events that
--   make it count, positions in the run
-- NULL: never; evidence is empty where it does not count
-- Example: fsar-ledger query cases/case_evidence LEDGER
-- Partial: the rows of a run do not depend on other runs
SELECT *
FROM case_1_evidence
UNION ALL
SELECT *
FROM case_2_evidence
UNION ALL
SELECT *
FROM case_3_evidence
UNION ALL
SELECT *
FROM case_4_evidence
