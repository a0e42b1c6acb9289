-- Title: Case 1: robot D, without trust, could not discover the capability in the registry; a nested query by DHMA's
--   agents found it and delegated
-- Paper: sec:evaluation:qualitative (case 1)
-- Grain: one row per claim of the case, architecture, configuration, seed and setting, as in case_claims
-- Key: claim, architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?
-- Units: as in case_claims
-- NULL: as in case_claims
-- Example: fsar-ledger query cases/case_1_trust_boundary LEDGER
SELECT *
FROM case_claims
WHERE case_number = 1
