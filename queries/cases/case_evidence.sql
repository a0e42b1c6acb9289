-- Title: The four cases, item by item: each request, run or handoff, and whether it counts
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim and item of which the record says what came of it, as in case_1_evidence to
--   case_4_evidence
-- Key: run_id, claim, seq
-- Units: counted how much the item adds to the numerator; seq the event with which it began, evidence those that make
--   it count, positions in the run
-- NULL: never; evidence is empty where it does not count
-- Example: fsar-ledger query cases/case_evidence LEDGER
-- Partial: what it says of a run does not depend on others
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
