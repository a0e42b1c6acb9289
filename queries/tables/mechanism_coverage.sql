-- Title: FSAR mechanisms exercised by each workflow, in the words of the paper's table
-- Paper: tab:coverage
-- Grain: one row per workflow, made_alike (as in run_groups) and mechanism, with the cells of all these runs
-- Key: workflow, made_alike, mechanism
-- Units: runs count
-- NULL: cell when no event exercises the mechanism; 'not observable' where the runs do not record what would show it
-- Example: fsar-ledger query tables/mechanism_coverage LEDGER
--   answers workflow-door-relay trust_evaluation: task
SELECT
    runs.scenario AS workflow, alike.made_alike, cells.mechanism,
    array_to_string(list_sort(list(DISTINCT cells.cell)), ' / ') AS cell,
    count(*) AS runs
FROM mechanism_cells AS cells
INNER JOIN runs ON cells.run_id = runs.run_id
INNER JOIN run_groups AS alike ON cells.run_id = alike.run_id
GROUP BY runs.scenario, cells.mechanism, alike.made_alike
