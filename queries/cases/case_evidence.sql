-- Title: The four cases, thing by thing that is counted or not: request, run, handoff
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim and thing of which the record says what came of it, as in case_1_evidence to case_4_evidence
-- Key: run_id, claim, seq
-- Units: counted how much the thing adds to the numerator; seq the event with which it began, evidence those that make
--   it count, positions in the run
-- NULL: never; evidence is empty where it does not count
-- Example: fsar-ledger query cases/case_evidence LEDGER
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
