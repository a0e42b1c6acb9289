-- Title: How often each mechanism of the paper decided something, in each scenario
-- Paper: eq:admissible, eq:adv, eq:override, eq:recovery, sec:evaluation:scenarios
-- Grain: one row per architecture, configuration, seed, setting (kind, source, model version, constants, fleet size),
--   scenario and mechanism
-- Key: architecture?, configuration?, seed?, fleet_size?, kind, source?, model_version?, constants?, scenario?,
--   mechanism
-- Units: runs count; times it decided in them: a robot left out of an answer, a refusal, a start that was held (once,
--   even if checked again); part is its place in the paper
-- NULL: times where the runs do not observe what would show it; seed, source, model version, scenario of runs that have
--   none; constants where all runs of the kind and model have the same
-- Example: fsar-ledger query metrics/mechanism_uses LEDGER
-- A mechanism that never decided has a row with 0, so that it is not credited with anything.
WITH listed (part, concern, names) AS (
    VALUES
    (
        'registry', 'registry',
        'left out: visibility; left out: version; left out: contract; left out: trust; left out: policy; '
        || 'left out: authority; left out: availability; left out: embodiment'
    ),
    (
        'evaluation', 'request',
        'denied: possession; denied: advertisement; denied: trust; denied: policy; denied: local-execution; '
        || 'denied: authority; denied: negotiation; denied: review; denied: no time left; deferred; counter-offer; '
        || 'passed on by a relay; override level in effect'
    ),
    ('policy', 'execution', 'start held: local-policy; start held: fleet-rule; motion withheld'),
    ('policy', 'policy', 'conflict escalated'),
    ('supervision', 'supervision', 'asked: review; asked: ordering; asked: recovery'),
    ('trust', 'trust', 'moved by record'),
    ('recovery', 'recovery', 'attempt rolled back; partial result; peer helps; step reassigned'),
    ('task', 'request', 'segment transferred'),
    ('task', 'task', 'given up')
),

mechanisms AS (
    SELECT part, concern, unnest(string_split(names, '; ')) AS mechanism
    FROM listed
),

counted AS (
    SELECT
        run_id, mechanism,
        count(DISTINCT about) AS times
    FROM mechanism_decisions
    GROUP BY run_id, mechanism
)

SELECT
    runs.architecture, runs.configuration, runs.fleet_size, settings.kind, runs.source, runs.model_version, runs.seed,
    settings.constants, runs.scenario, mechanisms.part, mechanisms.mechanism,
    count(*) AS runs,
    CASE
        WHEN bool_and(list_contains(runs.observes, mechanisms.concern))
            THEN coalesce(sum(counted.times), 0)::BIGINT
    END AS times
FROM runs
INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
CROSS JOIN mechanisms
LEFT JOIN counted ON runs.run_id = counted.run_id AND mechanisms.mechanism = counted.mechanism
GROUP BY
    runs.architecture, runs.configuration, settings.kind, runs.source, runs.model_version, runs.fleet_size, runs.seed,
    settings.constants, runs.scenario, mechanisms.part, mechanisms.mechanism
