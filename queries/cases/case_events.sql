-- Title: The events behind the numbers of the four cases, for `explain` and `prove`
-- Paper: sec:evaluation:qualitative
-- Grain: one row per claim, item (request, run, handoff) and event that makes it count; one row for an item that does
--   not count
-- Key: run_id, claim, case_seq, seq?
-- Units: counted how much the item adds to the numerator; case_seq the event with which the item began, seq the event
--   that makes it count, positions in the run
-- NULL: seq, type where nothing is counted; action_id (the event's, else the item's) where neither names one
-- Example: fsar-ledger query cases/case_events LEDGER --param number=3 --param architecture=cfc
-- Parameters: number: case = all, claim: claim = all, architecture: architecture = all, run: run = all
WITH asked AS (
    SELECT
        CASE
            WHEN count(*) = 0
                THEN
                    error(
                        'found number='
                        || $number
                        || ', claim='
                        || $claim
                        || ', expected those of a row of cases/case_definitions, or all'
                    )
        END AS wrong
    FROM case_definitions
    WHERE $number::VARCHAR IN ('all', case_number::VARCHAR) AND $claim IN ('all', claim)
),

chosen AS (
    SELECT
        definitions.case_number, evidence.claim, runs.architecture, runs.configuration, evidence.run_id,
        evidence.seq AS case_seq,
        evidence.counted,
        unnest(if(len(evidence.evidence) = 0, [NULL], evidence.evidence)) AS seq
    FROM case_evidence AS evidence
    INNER JOIN case_definitions AS definitions ON evidence.claim = definitions.claim
    INNER JOIN runs ON evidence.run_id = runs.run_id
    INNER JOIN asked ON asked.wrong IS NULL
    WHERE
        $number::VARCHAR IN ('all', definitions.case_number::VARCHAR) AND $claim IN ('all', evidence.claim)
        AND $architecture IN ('all', runs.architecture) AND $run IN ('all', evidence.run_id)
)

SELECT
    chosen.case_number, chosen.claim, chosen.architecture, chosen.configuration, chosen.run_id, chosen.case_seq,
    chosen.counted, chosen.seq, events.type,
    coalesce(events.action_id, things.action_id) AS action_id
FROM chosen
LEFT JOIN keyed_events AS events ON chosen.run_id = events.run_id AND chosen.seq = events.seq
LEFT JOIN keyed_events AS things ON chosen.run_id = things.run_id AND chosen.case_seq = things.seq
