-- Title: Isolations of robots, and how many of their results were accepted or overtaken afterwards
-- Paper: sec:architecture:overview, sec:architecture:invariants (A1)
-- Grain: one row per run of an isolated robot, and per handover of its results in a fleet's run
-- Key: run_id, seq
-- Units: began_us, ended_us microseconds of run time; accepted, overtaken results
-- NULL: fleet_run in a fleet's run; ended_us, accepted, overtaken in the run of the isolated robot, which does not
--   record them
-- Example: fsar-ledger query audit/isolations LEDGER
--   answers nothing, since no robot of the paper goes on alone
WITH results AS (
    SELECT run_id, caused_by, 1 AS accepted, 0 AS overtaken FROM isolated_result_accepted
    UNION ALL
    SELECT run_id, caused_by, 0 AS accepted, 1 AS overtaken FROM isolated_result_overtaken
),

counted AS (
    SELECT run_id, caused_by, sum(accepted)::BIGINT AS accepted, sum(overtaken)::BIGINT AS overtaken
    FROM results
    GROUP BY run_id, caused_by
)

SELECT
    run_id, seq, robot,
    run_id AS isolated_run,
    fleet_run,
    time_us AS began_us,
    NULL::BIGINT AS ended_us,
    NULL::BIGINT AS accepted,
    NULL::BIGINT AS overtaken
FROM isolation_began
UNION ALL
SELECT
    ended.run_id, ended.seq, ended.robot, ended.isolated_run,
    NULL AS fleet_run,
    ended.since_us AS began_us,
    ended.time_us AS ended_us,
    coalesce(counted.accepted, 0) AS accepted,
    coalesce(counted.overtaken, 0) AS overtaken
FROM isolation_ended AS ended
LEFT JOIN counted ON ended.run_id = counted.run_id AND ended.seq = counted.caused_by
