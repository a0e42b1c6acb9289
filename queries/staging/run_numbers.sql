-- Title: The number of each run: its position among the runs of the ledger, usable as its name
-- Paper: sec:evaluation:setup
-- Grain: one row per run
-- Key: run_id
-- Units: number counts from 1; plans have none
-- NULL: never
-- Example: fsar-ledger query staging/run_numbers LEDGER
SELECT
    run_id,
    row_number() OVER () AS number
FROM run_started
