-- Title: Time until others know of a failure
-- Paper: sec:model:recovery
-- Grain: one row per run
-- Key: run_id
-- Units: numerator microseconds from detection until another principal decides something about the action or a
--   supervisor is called, or until the failure is resolved or the task goes on or is given up, or else until the run
--   ends (its last record of these kinds); denominator failures; value seconds
-- NULL: value of a run without failures; numbers where the run does not observe what the metric rests on; not_observed
--   where it does
-- Example: fsar-ledger query metrics/time_to_know_s LEDGER
-- A failure of which no other principal hears counts as contained and causes no call; here it counts with its duration.
-- Partial: the rows of a run do not depend on other runs
WITH judged AS (
    SELECT
        failures.run_id,
        count(*) AS denominator,
        sum(
            coalesce(least(told.known_us, failures.resolved_us, told.passed_us), told.run_ended_us)
            - failures.detected_us
        )::BIGINT AS numerator
    FROM failures
    INNER JOIN failures_told AS told ON failures.run_id = told.run_id AND failures.seq = told.seq
    GROUP BY failures.run_id
)

SELECT
    runs.run_id,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.numerator, 0)::BIGINT END AS numerator,
    CASE WHEN hidden.run_id IS NULL THEN coalesce(judged.denominator, 0)::BIGINT END AS denominator,
    CASE WHEN hidden.run_id IS NULL THEN judged.numerator / nullif(judged.denominator, 0) / 1000000 END AS value,
    hidden.not_observed
FROM runs
LEFT JOIN judged ON runs.run_id = judged.run_id
LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = 'time_to_know_s'
