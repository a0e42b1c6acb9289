-- Title: The recordings that runs were imported from: format, clock, hash, and how many records yielded events
-- Paper: sec:evaluation:metrics
-- Grain: one row per run and opening of a source; a continued source was opened again
-- Key: run_id, seq
-- Units: record_count source records stored in the run, each once even if it was first cut off; underived_count those
--   that yielded no event: they say nothing relevant, or wait for another record, as a span for its parent
-- NULL: input_sha256 where the source is not a file; mapping_sha256 without a mapping; until_us while the source is
--   open, or where it was opened again without having been closed
-- Example: fsar-ledger query audit/recordings LEDGER answers which recordings the runs were imported from
WITH derived AS (
    SELECT DISTINCT run_id, caused_by AS seq
    FROM keyed_events
    WHERE caused_by IS NOT NULL AND run_id IN (SELECT run_id FROM source_opened)
    UNION
    -- Events derived from an imported record follow it directly, even when another event, such as the request, is their
    -- cause.
    SELECT observed.run_id, observed.seq
    FROM observed
    INNER JOIN keyed_events AS following ON observed.run_id = following.run_id AND observed.seq + 1 = following.seq
    WHERE
        observed.record_number IS NOT NULL
        AND following.type NOT IN ('Observed.v1', 'SourceOpened.v1', 'SourceClosed.v1')
),

whole AS (
    SELECT run_id, source, max(seq) AS seq
    FROM observed
    GROUP BY run_id, source, coalesce(record_number, -seq)
),

records AS (
    SELECT
        whole.run_id, whole.source,
        count(*) AS record_count,
        count(*) FILTER (derived.seq IS NULL) AS underived_count
    FROM whole
    LEFT JOIN derived ON whole.run_id = derived.run_id AND whole.seq = derived.seq
    GROUP BY whole.run_id, whole.source
),

closings AS (
    SELECT opened.run_id, opened.seq, max(closed.until_us) AS until_us
    FROM source_closed AS closed
    ASOF INNER JOIN source_opened AS opened
        ON closed.run_id = opened.run_id AND closed.source = opened.source AND closed.seq > opened.seq
    GROUP BY opened.run_id, opened.seq
)

SELECT
    opened.run_id, opened.seq, opened.source, opened.format, opened.adapter, opened.clock, opened.is_sampled,
    opened.input_sha256, opened.mapping_sha256,
    coalesce(records.record_count, 0) AS record_count,
    coalesce(records.underived_count, 0) AS underived_count,
    closings.until_us
FROM source_opened AS opened
LEFT JOIN records ON opened.run_id = records.run_id AND opened.source = records.source
LEFT JOIN closings ON opened.run_id = closings.run_id AND opened.seq = closings.seq
