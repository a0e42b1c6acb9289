-- Title: The missing records that would make each invariant and metric of a run observable, fewest first
-- Paper: sec:evaluation:metrics, sec:model:invariants, sec:architecture:invariants
-- Grain: one row per run and invariant or metric
-- Key: run_id, judge
-- Units: missing_count event types, fields or concerns
-- NULL: missing where nothing is missing; not_even_offences where it is observable
-- Example: fsar-ledger query audit/record_gaps LEDGER answers what a source would have to record for each judgement
-- Where not_even_offences is FALSE, a recorded offence counts, but nothing can be shown to hold.
WITH judges AS (
    SELECT DISTINCT judge, 'invariant' AS kind
    FROM judged_concerns
    WHERE regexp_matches(judge, '^[ia][1-5]_')
    UNION ALL
    SELECT metric AS judge, 'metric' AS kind
    FROM metric_definitions
)

SELECT
    runs.run_id,
    coalesce(len(string_split(hidden.not_observed, ', ')), 0) AS missing_count,
    judges.kind, judges.judge,
    hidden.judge IS NULL AS is_observable,
    hidden.not_observed AS missing,
    hidden.hides_offences AS not_even_offences
FROM runs
CROSS JOIN judges
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND judges.judge = hidden.judge
