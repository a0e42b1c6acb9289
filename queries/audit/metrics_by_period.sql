-- Title: The paper's eight metrics by day, or by part between two cuts
-- Paper: sec:evaluation:metrics
-- Grain: one row per run, period and metric: by day, each UTC day with records of a run whose start is known; by part,
--   each of the runs that continue one another, under its own name, or the whole of a run that continues none
-- Key: run_id, since_us, metric
-- Units: since_us, until_us microseconds of run time, half-open; numerator, denominator, value as in run_metrics, of
--   the tasks that arrived, the failures that were detected and all other cases that began in the period
-- NULL: until_us of the last part; value where nothing was counted; numbers where the run does not observe what the
--   metric rests on; not_observed where it does. Open work counts as in run_metrics (facts/open_work)
-- Example: fsar-ledger query audit/metrics_by_period LEDGER --param per=part answers how the shifts of a run compare
-- Parameters: run: run = all, per: period = day
WITH days AS (
    SELECT DISTINCT
        events.run_id,
        begun.epoch,
        (begun.epoch + to_microseconds(events.time_us))::DATE AS day
    FROM event_principals AS events
    INNER JOIN run_epochs AS begun ON events.run_id = begun.run_id
    WHERE $per = 'day' AND $run IN ('all', events.run_id)
),

parts AS (
    SELECT run_id, continues AS period, time_us AS until_us
    FROM run_continued
    WHERE $per = 'part' AND $run IN ('all', run_id)
    UNION ALL
    SELECT run_id, run_id AS period, NULL AS until_us
    FROM runs
    WHERE $per = 'part' AND $run IN ('all', run_id)
),

periods AS (
    SELECT
        run_id,
        day::VARCHAR AS period,
        greatest(epoch_us(day) - epoch_us(epoch), 0) AS since_us,
        epoch_us(day + 1) - epoch_us(epoch) AS until_us
    FROM days
    UNION ALL
    SELECT
        run_id, period,
        coalesce(lag(until_us) OVER (PARTITION BY run_id ORDER BY until_us NULLS LAST), 0) AS since_us,
        until_us
    FROM parts
),

counted AS (
    SELECT
        periods.run_id, periods.since_us, cases.metric,
        if(cases.metric = 'human_intervention', 1, sum(cases.numerator)::BIGINT) AS numerator,
        sum(cases.denominator)::BIGINT AS denominator
    FROM metric_cases AS cases
    ASOF JOIN periods ON cases.run_id = periods.run_id AND cases.time_us >= periods.since_us
    GROUP BY periods.run_id, periods.since_us, cases.metric
),

measured AS (
    SELECT
        periods.run_id, periods.period, periods.since_us, periods.until_us, metrics.metric, hidden.not_observed,
        metrics.numerator_units,
        if(hidden.run_id IS NULL, coalesce(counted.numerator, 0), NULL) AS numerator,
        if(
            hidden.run_id IS NULL, if(metrics.scale IN ('count', 'yes-no'), 1, coalesce(counted.denominator, 0)), NULL
        ) AS denominator
    FROM periods
    INNER JOIN metric_definitions AS metrics ON metrics.is_published
    LEFT JOIN counted
        ON periods.run_id = counted.run_id AND periods.since_us = counted.since_us AND metrics.metric = counted.metric
    LEFT JOIN unobservable AS hidden ON periods.run_id = hidden.run_id AND metrics.metric = hidden.judge
)

SELECT
    run_id, period, since_us, until_us, metric, numerator, denominator,
    numerator / nullif(denominator, 0) / numerator_units AS value,
    not_observed
FROM measured
