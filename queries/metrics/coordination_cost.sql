-- Title: Cost of coordination: messages, hops, decisions, look-ups and checks per request
-- Paper: sec:evaluation:scaling
-- Grain: one row per architecture, configuration and setting (kind, source, model version, constants, fleet size)
-- Key: architecture?, configuration?, setting
-- Units: runs, tasks, requests counts over all runs of the setting; a request is a step for which a robot lacks a
--   capability. Completed is the share of tasks completed within their budget. The rest are counts per request:
--   messages between principals, decisions other than routine and own steps, principals that these passed through
--   (hops), queries to a registry or to a coordinator's copy (look-ups), robots that the answers name, and answers to
--   requests (checks of trust, authority and policy). Setting, teams_working, encounter_mean_s, made_alike_but as in
--   dials
-- NULL: architecture, configuration, fleet_size and source of runs that have none; a count per request where there is
--   no request or nothing to count; completed without tasks; runs that do not observe what is counted are left out
-- Example: fsar-ledger query metrics/coordination_cost LEDGER
WITH told AS (
    -- A registry's answer is two messages; a decision on an own step is none, whichever principal decides it.
    SELECT
        type,
        count(*) AS messages
    FROM message_words
    WHERE sender <> receiver AND type <> 'OwnStepDecided.v1'
    GROUP BY type
),

counted AS (
    SELECT
        events.run_id,
        count(*) FILTER (WHERE events.type = 'GapDetected.v1') AS requests,
        sum(told.messages) AS messages,
        count(*) FILTER (WHERE events.type IN ('RegistryQueried.v1', 'CandidateMatched.v1')) AS look_ups,
        sum(len(events.candidates) + coalesce(len(events.rejected), 0)) AS robots_named,
        count(*) FILTER (
            WHERE events.type IN ('RequestAdmitted.v1', 'RequestDenied.v1', 'RequestCountered.v1')
        ) AS checks
    FROM events
    LEFT JOIN told ON events.type = told.type
    GROUP BY events.run_id
),

decided AS (
    SELECT
        run_id,
        count(*) AS decisions,
        sum(len(path)) AS hops
    FROM decisions
    WHERE decision_kind NOT IN ('routine', 'own-step')
    GROUP BY run_id
)

SELECT
    runs.architecture, runs.configuration, runs.fleet_size, settings.kind, runs.source, runs.model_version,
    settings.setting, dials.teams_working, dials.encounter_mean_s, dials.made_alike_but,
    count(*) AS runs,
    sum(success.denominator)::BIGINT AS tasks,
    sum(success.numerator) / nullif(sum(success.denominator), 0) AS completed,
    sum(counted.requests)::BIGINT AS requests,
    sum(counted.messages) / nullif(sum(counted.requests), 0) AS messages,
    sum(decided.decisions) / nullif(sum(counted.requests), 0) AS decisions,
    sum(decided.hops) / nullif(sum(counted.requests), 0) AS hops,
    sum(counted.look_ups) / nullif(sum(counted.requests), 0) AS look_ups,
    sum(counted.robots_named) / nullif(sum(counted.requests), 0) AS robots_named,
    sum(counted.checks) / nullif(sum(counted.requests), 0) AS checks
FROM runs
INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
INNER JOIN dials ON settings.setting = dials.setting
INNER JOIN counted ON runs.run_id = counted.run_id
LEFT JOIN decided ON runs.run_id = decided.run_id
LEFT JOIN coordination_success AS success ON runs.run_id = success.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'coordination_cost'
WHERE hidden.run_id IS NULL
GROUP BY
    runs.architecture, runs.configuration, runs.fleet_size, settings.kind, runs.source, runs.model_version,
    settings.setting, dials.teams_working, dials.encounter_mean_s, dials.made_alike_but
