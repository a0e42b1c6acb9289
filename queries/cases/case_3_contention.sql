-- Title: Case 3: two tasks need B's door.open.secure; FSAR defers one without a conflict, CFC assigns both and needs
--   H_F, DHMA's agents conflict
-- Paper: sec:evaluation:qualitative (case 3)
-- Grain: one row per claim of the case, architecture, configuration, seed and setting, as in case_claims
-- Key: claim, architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?
-- Units: as in case_claims
-- NULL: as in case_claims
-- Example: fsar-ledger query cases/case_3_contention LEDGER
SELECT *
FROM case_claims
WHERE case_number = 3
