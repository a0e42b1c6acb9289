-- Title: Contributions of pairs of runs of two sides to the difference of a metric
-- Paper: sec:evaluation:significance
-- Grain: one row per pair of runs (side_pairs) that both count, metric, its seed or all seeds (pools_seeds), and its
--   scenario or all scenarios
-- Key: first_side, second_side, first_run_id, second_run_id, metric, pools_seeds, scenario?
-- Units: contribution in the metric's unit: first minus second, and of a pooled metric the pseudo-value of the
--   jackknife, n * difference - (n - 1) * difference without the pair; direction 1 where the first side is higher, -1
--   where the second is, 0 where neither is, for a pooled metric relative to the ratio of both together; differs
--   whether the pair's runs count the same; first_ratio, second_ratio the pooled values of the sides;
--   first_contribution, second_contribution what each run alone contributes to the mean of its side
-- NULL: seed for all seeds, scenario for all scenarios; contribution where a side counts nothing without the pair;
--   ratios of metrics that are not pooled, or where nothing is counted. Pairs in which a run has no value, of a pooled
--   metric one that does not observe it, are left out
-- Example: fsar-ledger query statistics/side_values LEDGER
WITH measured AS (
    SELECT
        pairs.first_side, pairs.second_side, pairs.first_run_id, pairs.second_run_id, scopes.pools_seeds,
        CASE WHEN NOT scopes.pools_seeds THEN pairs.seed END AS seed,
        CASE WHEN scopes.is_of_scenario THEN pairs.scenario END AS scenario,
        firsts.metric, definitions.is_pooled, definitions.numerator_units,
        firsts.value AS first_value,
        seconds.value AS second_value,
        firsts.numerator AS n1,
        firsts.denominator AS d1,
        seconds.numerator AS n2,
        seconds.denominator AS d2
    FROM side_pairs AS pairs
    INNER JOIN
        (VALUES (FALSE, FALSE), (FALSE, TRUE), (TRUE, FALSE), (TRUE, TRUE)) AS scopes (pools_seeds, is_of_scenario)
        ON pairs.differs IS NULL
    INNER JOIN side_runs AS firsts ON pairs.first_side = firsts.side AND pairs.first_run_id = firsts.run_id
    INNER JOIN side_runs AS seconds
        ON pairs.second_side = seconds.side AND pairs.second_run_id = seconds.run_id AND firsts.metric = seconds.metric
    INNER JOIN metric_definitions AS definitions ON firsts.metric = definitions.metric
    WHERE
        if(
            definitions.is_pooled,
            n1 IS NOT NULL AND n2 IS NOT NULL,
            first_value IS NOT NULL AND second_value IS NOT NULL
        )
),

totals AS (
    SELECT
        first_side, second_side, first_run_id, second_run_id, pools_seeds, seed, scenario, metric, is_pooled,
        first_value, second_value, n1, d1, n2, d2,
        count(*) OVER cell AS n,
        sum(n1) OVER cell AS s1,
        nullif(sum(d1) OVER cell, 0) AS t1,
        sum(n2) OVER cell AS s2,
        nullif(sum(d2) OVER cell, 0) AS t2,
        s1::DOUBLE / t1::DOUBLE / numerator_units AS r1,
        s2::DOUBLE / t2::DOUBLE / numerator_units AS r2,
        (s1 - n1)::DOUBLE / nullif(t1 - d1, 0)::DOUBLE / numerator_units AS r1_without_it,
        (s2 - n2)::DOUBLE / nullif(t2 - d2, 0)::DOUBLE / numerator_units AS r2_without_it,
        ((s1 - n1)::DOUBLE / nullif(t1 - d1, 0)::DOUBLE - (s2 - n2)::DOUBLE / nullif(t2 - d2, 0)::DOUBLE)
        / numerator_units AS without_it
    FROM measured
    WINDOW cell AS (PARTITION BY first_side, second_side, pools_seeds, seed, scenario, metric)
)

SELECT
    first_side, second_side, first_run_id, second_run_id, pools_seeds, seed, scenario, metric, is_pooled, first_value,
    second_value,
    CASE WHEN is_pooled THEN r1 END AS first_ratio,
    CASE WHEN is_pooled THEN r2 END AS second_ratio,
    if(is_pooled, n1 <> n2 OR d1 <> d2, round((first_value - second_value) * 1e9) <> 0) AS differs,
    if(is_pooled, n * (r1 - r2) - (n - 1) * without_it, first_value - second_value) AS contribution,
    if(is_pooled, n * r1 - (n - 1) * r1_without_it, first_value) AS first_contribution,
    if(is_pooled, n * r2 - (n - 1) * r2_without_it, second_value) AS second_contribution,
    CASE
        WHEN is_pooled THEN sign((n1 - n2)::HUGEINT * (t1 + t2)::HUGEINT - (s1 + s2)::HUGEINT * (d1 - d2)::HUGEINT)
        ELSE sign(round((first_value - second_value) * 1e9))
    END::INTEGER AS direction
FROM totals
