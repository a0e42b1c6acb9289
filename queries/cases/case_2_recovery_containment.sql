-- Title: Case 2: D's failure was contained by local recovery under FSAR, escalated at once under CFC, disputed, then
--   escalated, under DHMA
-- Paper: sec:evaluation:qualitative (case 2)
-- Grain: one row per claim of the case, architecture, configuration, seed and setting, as in case_claims
-- Key: claim, architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?
-- Units: as in case_claims
-- NULL: as in case_claims
-- Example: fsar-ledger query cases/case_2_recovery_containment LEDGER
SELECT *
FROM case_claims
WHERE case_number = 2
