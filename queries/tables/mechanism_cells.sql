-- Title: How each run of a workflow exercises FSAR's mechanisms, in the words of the paper's table
-- Paper: tab:coverage
-- Grain: one row per run of a workflow and mechanism
-- Key: run_id, mechanism
-- Units: none; cell is text
-- NULL: cell when no event exercises the mechanism; 'not observable' where the run does not record what would show it
-- Example: fsar-ledger query tables/mechanism_cells LEDGER
-- Partial: the rows of a run do not depend on other runs
WITH seen AS (
    SELECT
        runs.run_id, runs.scenario,
        count(*) FILTER (events.type = 'RequestIssued.v1') AS requests,
        count(*) FILTER (
            events.type = 'AssistanceRequested.v1' OR (events.type = 'RecoveryEscalated.v1' AND to_level = 'peer')
        ) AS peer_questions,
        count(*) FILTER (events.type = 'RequestAdmitted.v1') AS admitted,
        string_agg(DISTINCT trust, ', ' ORDER BY trust DESC) FILTER (events.type = 'RequestAdmitted.v1') AS trust,
        bool_and(coalesce(may_request AND may_execute AND override = 'none' AND is_audited, FALSE)) FILTER (
            events.type = 'RequestAdmitted.v1' AND may_request IS NOT NULL
        ) AS is_standard,
        bool_or(events.type = 'SupervisorCalled.v1' AND events.purpose IN ('review', 'ordering')) AS is_reviewed,
        bool_or(events.type = 'SupervisorCalled.v1' AND events.purpose = 'ordering') AS is_conflict,
        bool_or(events.type = 'RequestDenied.v1' AND events.reason = 'policy') AS is_denied,
        count(*) FILTER (events.type = 'RegistryQueried.v1') AS queries,
        min(len(events.candidates)) FILTER (events.type = 'RegistryQueried.v1') AS fewest,
        max(len(events.candidates)) FILTER (events.type = 'RegistryQueried.v1') AS most,
        bool_or(events.helper IS NOT NULL) FILTER (events.type = 'ReassignmentDecided.v1') AS is_reassigned,
        bool_or(events.type = 'RecoveryEscalated.v1' AND events.to_level = 'human') AS is_human,
        bool_or(events.type = 'RequestIssued.v1' AND coalesce(events.relay, events.parent) IS NOT NULL) AS is_chain
    FROM runs
    INNER JOIN events ON runs.run_id = events.run_id
    WHERE starts_with(runs.scenario, 'workflow-')
    GROUP BY runs.run_id, runs.scenario
),

levels AS (
    SELECT run_id, count(DISTINCT level) AS levels
    FROM recovery_moves
    GROUP BY run_id
),

cells AS (
    SELECT
        seen.run_id,
        unnest([
            'inter_robot_request', 'trust_evaluation', 'authority_tuple', 'policy_composition', 'registry_discovery',
            'layered_recovery', 'fleet_reassignment', 'human_escalation', 'delegation_chain'
        ]) AS mechanism,
        unnest([
            CASE WHEN requests > 0 THEN 'yes' WHEN peer_questions > 0 THEN 'via recovery' END,
            trust, CASE WHEN is_standard THEN 'standard' WHEN NOT is_standard THEN 'other' END,
            CASE
                WHEN requests = 0 THEN NULL
                WHEN is_reviewed THEN 'review'
                WHEN is_denied THEN 'deny'
                WHEN admitted > 0 THEN 'allow'
            END,
            CASE
                WHEN queries = 0 THEN NULL
                WHEN is_conflict THEN 'conflict'
                WHEN fewest = 0 THEN 'no peer'
                ELSE if(most = 1, 'single', 'several')
            END,
            CASE levels.levels WHEN 4 THEN 'all 4 levels' ELSE levels.levels || ' of 4 levels' END,
            CASE WHEN is_reassigned THEN 'done' WHEN NOT is_reassigned THEN 'attempted' END,
            CASE WHEN is_human THEN 'level 4' WHEN is_conflict THEN 'conflict' WHEN is_reviewed THEN 'review' END,
            CASE WHEN requests > 0 THEN if(is_chain, 'several links', 'single') END
        ]) AS cell
    FROM seen
    LEFT JOIN levels ON seen.run_id = levels.run_id
)

SELECT
    cells.run_id, cells.mechanism,
    if(hidden.run_id IS NULL, cells.cell, 'not observable') AS cell
FROM cells
LEFT JOIN unobservable AS hidden ON cells.run_id = hidden.run_id AND cells.mechanism = hidden.judge
