-- Title: The share of each count that is routine, or recorded while the supervisor in charge is off shift
-- Paper: sec:evaluation:metrics
-- Grain: one row per architecture, configuration, seed and setting (kind, source, model version, constants, fleet size)
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?
-- Units: counts, and shares of them: routine operations among decisions, local decisions, coordination events and
--   policy violations; among coordination events, those during a recorded absence of the supervisor in charge (R8)
-- NULL: seed, source, model version of runs that have none; constants where all runs of the kind and model have the
--   same; shares of a count of 0; runs that do not observe decisions, records and policy are left out
-- Example: fsar-ledger query metrics/background LEDGER
WITH counted AS (
    SELECT
        run_id,
        decision_kind = 'routine' AS decided,
        CASE WHEN is_local THEN decision_kind = 'routine' END AS decided_locally,
        NULL::BOOLEAN AS recorded,
        NULL::BOOLEAN AS violated,
        NULL::BOOLEAN AS is_off_shift
    FROM decisions
    UNION ALL BY NAME
    SELECT
        run_id,
        record_kind = 'routine' AS recorded,
        is_off_shift
    FROM coordination_events
    UNION ALL BY NAME
    SELECT
        run_id,
        action_id IS NULL AS violated
    FROM governed_starts
    WHERE is_violation
)

SELECT
    runs.architecture, runs.configuration, runs.fleet_size, settings.kind, runs.source, runs.model_version, runs.seed,
    settings.constants,
    count(counted.decided) AS decisions,
    avg(counted.decided::INTEGER) AS routine_share_of_decisions,
    count(counted.decided_locally) AS local_decisions,
    avg(counted.decided_locally::INTEGER) AS routine_share_of_local_decisions,
    count(counted.recorded) AS coordination_events,
    avg(counted.recorded::INTEGER) AS routine_share_of_coordination_events,
    count(counted.violated) AS policy_violations,
    avg(counted.violated::INTEGER) AS routine_share_of_policy_violations,
    avg(counted.is_off_shift::INTEGER) AS off_shift_share_of_coordination_events
FROM runs
INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
LEFT JOIN counted ON runs.run_id = counted.run_id
LEFT JOIN unobservable AS hidden
    ON
        runs.run_id = hidden.run_id
        AND hidden.judge IN ('governance_locality', 'audit_attributability', 'policy_violations')
WHERE hidden.run_id IS NULL
GROUP BY
    runs.architecture, runs.configuration, settings.kind, runs.source, runs.model_version, runs.fleet_size, runs.seed,
    settings.setting, settings.constants
