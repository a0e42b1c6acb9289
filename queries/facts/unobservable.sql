-- Title: What cannot be judged of a run, because its source does not record what the judgement rests on
-- Paper: sec:evaluation:metrics
-- Grain: one row per run and judge that rests on a concern that the run does not observe
-- Key: run_id, judge
-- Units: none
-- NULL: never; not_observed names the concerns, hides_offences tells whether not even an offence could be found
-- Example: fsar-ledger query facts/unobservable LEDGER
-- Stored: every metric, invariant and grade reads it
WITH sources AS (
    -- There are few kinds of source and many runs.
    SELECT DISTINCT coalesce(observes, []) AS observes
    FROM runs
),

lacking AS (
    SELECT
        sources.observes, needed.judge,
        string_agg(needed.concern, ', ' ORDER BY needed.concern) AS not_observed,
        bool_or(needed.is_context) AS hides_offences
    FROM sources
    INNER JOIN judged_concerns AS needed ON NOT list_contains(sources.observes, needed.concern)
    GROUP BY sources.observes, needed.judge
)

SELECT runs.run_id, lacking.judge, lacking.not_observed, lacking.hides_offences
FROM runs
INNER JOIN lacking ON coalesce(runs.observes, []) = lacking.observes
