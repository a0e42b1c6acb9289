-- Title: The trust in force at a time
-- Paper: eq:trust
-- Grain: one row per run, ordered pair of robots and entry that had been set by then; asked about a capability or context, only the entry that holds for it
-- Units: since_us, until_us, at_us microseconds of run time, half-open; the default time is after the end of every run
-- NULL: capability, context when the entry is about all of them; until_us when it was not set again; set_by for what the fleet was founded with;
--   a pair without a row had no trust
-- Example: fsar-ledger query audit/trust_at LEDGER --param run=RUN --param robot=robot/B1 --param peer=robot/A1 --param at_us=30000000
--   answers robot/B1 trusts robot/A1 with scope task since 0, for every capability and context
-- Parameters: run = all, robot = all, peer = all, capability = all, context = all, at_us = 9007199254740991
WITH entries AS (
    SELECT
        *,
        $capability = 'all' AND $context = 'all' AS is_listed
    FROM trust_in_force
    WHERE
        $run IN ('all', run_id)
        AND $robot IN ('all', robot)
        AND $peer IN ('all', peer)
        AND since_us <= $at_us::BIGINT
        AND (until_us IS NULL OR until_us > $at_us::BIGINT)
)

SELECT
    run_id,
    robot,
    peer,
    capability,
    context,
    trust_scope,
    since_us,
    until_us,
    set_by,
    reason
FROM entries
WHERE is_listed OR ((capability IS NULL OR capability = $capability) AND (context IS NULL OR context = $context))
QUALIFY is_listed OR row_number() OVER (PARTITION BY run_id, robot, peer ORDER BY precedence DESC) = 1
