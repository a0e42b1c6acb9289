-- Title: Case 4: for a handoff from A to D, FSAR records all events with principals, CFC leaves some unattributed, DHMA
--   adds internal ones
-- Paper: sec:evaluation:qualitative (case 4)
-- Grain: one row per claim of the case, architecture, configuration, seed and setting, as in case_claims
-- Key: claim, architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?
-- Units: as in case_claims
-- NULL: as in case_claims
-- Example: fsar-ledger query cases/case_4_audit_trail LEDGER
SELECT *
FROM case_claims
WHERE case_number = 4
