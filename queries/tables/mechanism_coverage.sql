-- Title: FSAR mechanisms exercised by each workflow, in the words of the paper's table
-- Paper: tab:coverage
-- Grain: one row per workflow, made_alike (as in run_groups) and mechanism; runs of one workflow that differ show each
--   of their cells
-- Key: workflow, made_alike, mechanism
-- Units: runs count
-- NULL: cell when no event of the workflow exercises the mechanism; 'not observable' where its runs do not record what
--   would show it
-- Example: fsar-ledger query tables/mechanism_coverage LEDGER
--   answers workflow-door-relay trust_evaluation: task
WITH seen AS (
    SELECT
        runs.run_id, runs.scenario,
        count(*) FILTER (events.type = 'RequestIssued.v1') AS requests,
        count(*) FILTER (
            events.type = 'AssistanceRequested.v1'
            OR (events.type = 'RecoveryEscalated.v1' AND events.to_level = 'peer')
        ) AS peer_questions,
        count(*) FILTER (events.type = 'RequestAdmitted.v1') AS admitted,
        string_agg(DISTINCT events.trust, ', ' ORDER BY events.trust DESC) FILTER (events.type = 'RequestAdmitted.v1')
            AS trust,
        bool_and(
            coalesce(
                events.may_request AND events.may_execute AND events.override = 'none' AND events.is_audited, FALSE
            )
        ) FILTER (events.type = 'RequestAdmitted.v1' AND events.may_request IS NOT NULL) AS is_standard,
        bool_or(events.type = 'SupervisorCalled.v1' AND events.purpose IN ('review', 'ordering')) AS is_reviewed,
        bool_or(events.type = 'SupervisorCalled.v1' AND events.purpose = 'ordering') AS is_conflict,
        bool_or(events.type = 'RequestDenied.v1' AND events.reason = 'policy') AS is_denied,
        count(*) FILTER (events.type = 'RegistryQueried.v1') AS queries,
        min(len(events.candidates)) FILTER (events.type = 'RegistryQueried.v1') AS fewest,
        max(len(events.candidates)) FILTER (events.type = 'RegistryQueried.v1') AS most,
        bool_or(events.type = 'ReassignmentDecided.v1' AND events.helper IS NOT NULL) AS is_reassigned,
        count(*) FILTER (events.type = 'ReassignmentDecided.v1') AS reassignments,
        bool_or(events.type = 'RecoveryEscalated.v1' AND events.to_level = 'human') AS is_human,
        bool_or(events.type = 'RequestIssued.v1' AND (events.relay IS NOT NULL OR events.parent IS NOT NULL))
            AS is_chain
    FROM runs
    INNER JOIN events ON runs.run_id = events.run_id
    WHERE starts_with(runs.scenario, 'workflow-')
    GROUP BY runs.run_id, runs.scenario
),

levels AS (
    SELECT
        run_id,
        count(DISTINCT level) AS levels
    FROM recovery_moves
    GROUP BY run_id
),

cells AS (
    SELECT
        seen.run_id, seen.scenario,
        unnest([
            {
                'mechanism': 'inter_robot_request',
                'cell': if(requests > 0, 'yes', if(peer_questions > 0, 'via recovery', NULL))
            },
            { 'mechanism': 'trust_evaluation', 'cell': trust },
            {
                'mechanism': 'authority_tuple',
                'cell': if(is_standard, 'standard', if(is_standard IS NULL, NULL, 'other'))
            },
            {
                'mechanism': 'policy_composition',
                'cell': if(
                    requests = 0, NULL,
                    if(is_reviewed, 'review', if(is_denied, 'deny', if(admitted > 0, 'allow', NULL)))
                )
            },
            {
                'mechanism': 'registry_discovery',
                'cell': CASE
                    WHEN queries = 0 THEN NULL WHEN is_conflict THEN 'conflict' WHEN fewest = 0 THEN 'no peer' ELSE
                        if(most = 1, 'single', 'several')
                END
            },
            {
                'mechanism': 'layered_recovery',
                'cell': CASE levels.levels WHEN 4 THEN 'all 4 levels' ELSE levels.levels || ' of 4 levels' END
            },
            {
                'mechanism': 'fleet_reassignment',
                'cell': if(reassignments = 0, NULL, if(is_reassigned, 'done', 'attempted'))
            },
            {
                'mechanism': 'human_escalation',
                'cell': CASE
                    WHEN is_human THEN 'level 4' WHEN is_conflict THEN 'conflict' WHEN is_reviewed THEN 'review'
                END
            },
            {
                'mechanism': 'delegation_chain',
                'cell': CASE WHEN requests = 0 THEN NULL WHEN is_chain THEN 'several links' ELSE 'single' END
            }
        ]) AS fact
    FROM seen
    LEFT JOIN levels ON seen.run_id = levels.run_id
)

SELECT
    cells.scenario AS workflow,
    alike.made_alike,
    cells.fact.mechanism,
    array_to_string(
        list_sort(array_agg(DISTINCT if(hidden.run_id IS NULL, cells.fact.cell, 'not observable'))), ' / '
    ) AS cell,
    count(DISTINCT cells.run_id) AS runs
FROM cells
INNER JOIN run_groups AS alike ON cells.run_id = alike.run_id
LEFT JOIN unobservable AS hidden ON cells.run_id = hidden.run_id AND cells.fact.mechanism = hidden.judge
GROUP BY cells.scenario, cells.fact.mechanism, alike.made_alike
