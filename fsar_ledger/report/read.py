"""Read the results from one head of a ledger. Besides `findings`, no other module of the report queries runs.

All numbers come from packaged queries (`queries/`). Their answers become relations of `Findings`, by name, from which
the sections of `reports/sections/` select.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa

from fsar_ledger.base.progress import Progress, Showing, unseen
from fsar_ledger.events.configuration import FULL, PAPER_ARCHITECTURES
from fsar_ledger.metrics.comparability import differing_worlds
from fsar_ledger.metrics.database import Database, connect, from_rows
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.library import READINGS, library
from fsar_ledger.metrics.multiverse import Cell, Multiverse, Reading, cells, readings, universes
from fsar_ledger.metrics.results import (
    CONDITIONS,
    MetricRow,
    StatisticRow,
    drawn_effects,
    measure_the_printed,
    metric_rows,
    models,
    of_all_seeds,
    same_setting,
    setting_of,
    statistic_rows,
    take_seeds_together,
)
from fsar_ledger.metrics.robustness import OrderUnderReadings, rankings
from fsar_ledger.metrics.verdicts import ComparedEffect, compare_effects
from fsar_ledger.report import judge
from fsar_ledger.report.findings import (
    Findings,
    Part,
    Relations,
    arrow,
    experiments_of,
    ledger_head,
    read_ledger,
    sources_of,
)
from fsar_ledger.report.judge import FOUR_ROBOTS, RunCounts
from fsar_ledger.report.printing import flat

QUERIES = {
    "results": (
        *("metrics/metric_summary", "metrics/background", "statistics/pairwise_tests", "statistics/pooled_tests"),
        *("statistics/differing_worlds", "statistics/drawn_experiments", "staging/runs", "audit/experiments"),
        *("audit/unplanned_runs", "tables/architecture_features", "cases/case_claims", "metrics/mechanism_uses"),
        "statistics/drawn_effects",
    ),
    "ablation": ("metrics/metrics_by_dial", "statistics/drawn_experiments", "statistics/drawn_scenarios"),
    "scaling": ("metrics/metrics_by_dial", "metrics/coordination_cost", "statistics/drawn_experiments"),
    "mechanisms": ("statistics/mechanism_differences",),
    "workflows": ("tables/mechanism_coverage", "audit/requests", "audit/request_timeline", "audit/failure_timeline"),
    "churn": ("audit/churn",),
}
"""The queries that each part of the report reads directly; these read others."""

OF_MAIN = same_setting("runs.")
ADDED = "architectures added"
"""The family of comparisons with architectures that the paper does not compare."""
CHOSEN_SQL = f"""
    SELECT run_id, seed
    FROM (
        SELECT runs.* EXCLUDE (kind), settings.kind, settings.constants
        FROM runs
        INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    ) AS runs
    WHERE {OF_MAIN}
"""
HELD_SQL = {
    "architecture": f"""
        SELECT runs.architecture AS of, runs.scenario, count(*) AS runs
        FROM runs INNER JOIN ({CHOSEN_SQL}) AS chosen ON runs.run_id = chosen.run_id
        WHERE list_contains(['fsar', 'cfc', 'dhma'], runs.architecture)
        GROUP BY ALL ORDER BY ALL
    """,
    "comparison": f"""
        SELECT run_pairs.comparison AS of, run_pairs.scenario, count(*) AS runs
        FROM run_pairs INNER JOIN ({CHOSEN_SQL}) AS chosen ON run_pairs.first_run_id = chosen.run_id
        WHERE
            run_pairs.differs IS NULL
            AND list_contains(['fsar-cfc', 'fsar-dhma', 'cfc-dhma'], run_pairs.comparison)
        GROUP BY ALL ORDER BY ALL
    """,
}
MAIN_SQL = {
    "background": f"SELECT * FROM background AS runs WHERE {OF_MAIN} ORDER BY ALL",
    "features": f"SELECT feature, architecture, grade FROM architecture_features AS runs WHERE {OF_MAIN} ORDER BY ALL",
    "uses": f"""
        SELECT architecture, scenario, part, mechanism, times FROM mechanism_uses AS runs WHERE {OF_MAIN} ORDER BY ALL
    """,
    "claims_of_cases": f"SELECT * FROM case_claims AS runs WHERE {OF_MAIN} ORDER BY ALL",
}
RUNS_SQL = """
    SELECT
        configuration, fleet_size, architecture, count(DISTINCT scenario) AS scenarios, count(*) AS runs,
        min(seed) AS first_seed, max(seed) AS last_seed, count(DISTINCT seed) AS seeds, min(run) AS first_run,
        max(run) AS last_run
    FROM runs
    GROUP BY configuration, fleet_size, architecture
    ORDER BY configuration <> 'full', configuration, fleet_size, list_position(['fsar', 'cfc', 'dhma'], architecture)
"""


def gather(
    ledger: Path,
    demanded: str | None = None,
    beside: Mapping[Path, str | None] | None = None,
    *,
    workflows: Path | None = None,
    reads_every_way: bool = False,
    showing: Showing = unseen,
) -> Findings:
    """Return the findings of the ledger's current head and of the ledgers beside it.

    Args:
        ledger: The folder of the ledger.
        demanded: The newest record that its head must have; None: any.
        beside: Other ledgers, each with its demanded record; where two have runs for the same part, the first one's are
            shown.
        workflows: The one of them that must hold workflows, if any.
        reads_every_way: Whether to add the multiverse of readings, which costs as much as all other results.
        showing: Called with a verb and a unit for long steps.

    Raises:
        UsageError: A ledger beside it holds nothing that the report shows.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `connect`.
    """
    parts: dict[str, Part] = {}
    for other, record in (beside or {}).items():  # first: a mistaken path fails at once
        parts = read_ledger(other, record, is_workflows=other == workflows) | parts
    with connect(ledger, demanded=demanded) as database:
        measure_the_printed(database)
        rows = [
            row
            for by_scenario in (False, True)
            for row in metric_rows(database, by_scenario, pools_seeds=True)
            if row.architecture in PAPER_ARCHITECTURES
        ]
        main = _main(rows)
        results = _results(database, rows, main, ledger, demanded)
        parts = {"results": results[0]} | experiments_of(database) | parts
        parts = {name: parts[name] for name in QUERIES if name in parts}
        sets, parameters, digest = _models(database, main)
        multiverse = None
        if reads_every_way and main is not None and not results[1]:
            with showing("read", "combinations of readings") as progress:
                multiverse = multiverse_of(database, main, progress=progress)
        relations = {name: table for part in parts.values() for name, table in part.relations.items()}
        if "differences" not in relations:  # only its columns: nothing of this ledger is measured
            with from_rows((), threads=1) as empty:
                relations["differences"] = empty.table("SELECT * FROM mechanism_differences")
        relations |= {"runs": database.table(RUNS_SQL), **relations_of(multiverse)}
        relations |= {"models": pa.Table.from_pylist(sets)} if sets else {}
        query_names = [query for name in parts for query in QUERIES[name]]
        query_names += [name for name in library().queries if name.startswith(READINGS)] if reads_every_way else []
        return Findings(
            heads={name: part.head for name, part in parts.items()},
            numbers=tuple(number for part in parts.values() for number in part.numbers),
            relations=relations,
            sources=sources_of(database, query_names),
            parameters=parameters,
            parameters_sha256=digest,
            model_version=main[CONDITIONS.index("model_version")] if main else None,
            model_versions=tuple(sorted({model["model_version"] for model in sets} - {None})),
            table_share=results[2],
            unjudged=results[1],
            shown=_shown_runs_note(main, rows),
            differing=tuple(map(str, differing_worlds(database))),
            multiverse=multiverse,
        )


Main = tuple[Any, ...]
"""The `CONDITIONS` that the runs of the tables share; the seed is None, because all seeds are pooled."""


def _main(rows: Sequence[MetricRow]) -> Main | None:
    """Return the setting of the tables: four robots in full; among several, the first of those with most runs."""
    counts: Counter[Main] = Counter()
    for row in rows:
        if row.scenario is None and (row.configuration, row.fleet_size) == (FULL, FOUR_ROBOTS):
            counts[setting_of(row)] += row.n
    return max(counts, key=counts.__getitem__, default=None)


def _results(
    database: Database, rows: Sequence[MetricRow], main: Main | None, ledger: Path, demanded: str | None
) -> tuple[Part, str | None, float | None]:
    """Return the results, why some are not judged, and the share of drawn tables as far out as the printed one."""
    main_rows = [row for row in rows if setting_of(row) == main]
    counts = {} if main is None else {kind: _count_runs(database, main, kind) for kind in HELD_SQL}
    pair = counts.get("architecture", {}), counts.get("comparison", {})
    not_judged = judge.unjudged(*pair)
    drawn = judge.drawn_odds(database, "results", main_rows)
    numbers = judge.beside("results", main_rows, drawn, not_judged=not_judged)
    tests = [
        row for row in statistic_rows(database, pools_seeds=True) if setting_of(row) == main and row.family != ADDED
    ]
    relations = {
        "measured": arrow(main_rows, MetricRow),
        "other_runs": arrow([row for row in rows if row.scenario is None and setting_of(row) != main], MetricRow),
        "paired": arrow(tests, StatisticRow),
        "predictive": arrow(_predictive(database, main, tests, pair[1]), ComparedEffect),
        "not_judged": pa.table({"name": pa.array(sorted(not_judged), pa.string())}),
    }
    conditions = of_all_seeds(main or (None,) * len(CONDITIONS))
    with _of_one_seed(ledger, demanded, database, main) as narrowed:
        relations |= {name: narrowed.table(sql, conditions) for name, sql in MAIN_SQL.items()}
    share = None if drawn is None or not_judged else drawn.table
    head = ledger_head(database, main[CONDITIONS.index("model_version")] if main else None)
    return Part(head, tuple(numbers), relations), judge.why_unjudged(*pair), share


def _predictive(
    database: Database, main: Main | None, tests: Sequence[StatisticRow], pairs: Mapping[str, RunCounts]
) -> list[ComparedEffect]:
    """Judge for each printed effect size whether as many pairs as the paper's could have printed it.

    Comparisons with fewer pairs of a scenario than that are left out, like such numbers in `judge.drawn_odds`.
    """
    enough = [row for row in tests if min(pairs.get(row.comparison, {}).values(), default=0) >= judge.PAPER_RUNS]
    return [] if main is None or not enough else compare_effects(enough, drawn_effects(database, main))


def _count_runs(database: Database, main: Main, kind: str) -> dict[str, RunCounts]:
    """Return the number of main runs by architecture and scenario, or of their pairs by comparison and scenario."""
    counts: dict[str, dict[str | None, int]] = {}
    for row in database.rows(HELD_SQL[kind], of_all_seeds(main)):
        counts.setdefault(row["of"], {})[row["scenario"]] = row["runs"]
    return dict(counts)


@contextmanager
def _of_one_seed(ledger: Path, demanded: str | None, database: Database, main: Main | None) -> Iterator[Database]:
    """Yield a database in which the main runs have no seed, so that queries that separate seeds pool them.

    If they have one seed, it is the given database, since a new one has to read and judge them again.
    """
    chosen = database.table(CHOSEN_SQL, of_all_seeds(main or (None,) * len(CONDITIONS)))
    if len(set(chosen["seed"].to_pylist())) <= 1:
        yield database
        return
    with connect(ledger, demanded=demanded) as narrowed:
        narrowed.hold("chosen_runs", chosen)
        take_seeds_together(narrowed, "run_id IN (SELECT run_id FROM chosen_runs)")
        measure_the_printed(narrowed)
        yield narrowed


def _shown_runs_note(main: Main | None, rows: Sequence[MetricRow]) -> str | None:
    """Return which runs the tables show, if the ledger holds others of the same configuration and fleet size."""
    if main is None or {setting_of(row) for row in rows if setting_of(row)[:2] == main[:2]} == {main}:
        return None
    setting = of_all_seeds(main)
    parts = (f"{setting['kind']} runs", setting["source"], f"model {setting['model_version']}", setting["constants"])
    return f"The tables are of {', '.join(filter(None, parts))}; runs made otherwise are never pooled with these."


def _models(database: Database, main: Main | None) -> tuple[list[dict[str, Any]], dict[str, str], str | None]:
    """Return the sets of constants in the ledger, that of the main runs by dotted name, and its SHA-256.

    Without main runs, the constants are those of the first run that records some.
    """
    listed = models(database)
    ours = [
        model
        for model in listed
        if main is not None and (model.source, model.model_version, model.constants) == main[4:]
    ]
    rows = [
        {name: getattr(model, name) for name in ("model_version", "kind", "runs", "constants", "sha256")}
        for model in listed
    ]
    recorded = next((model for model in ours or listed if model.parameters), None)
    return rows, dict(flat("", recorded.parameters if recorded else {})), recorded.sha256 if recorded else None


def multiverse_of(database: Database, main: Main, *, progress: Progress | None = None) -> Multiverse | None:
    """Return the multiverse of all published metrics for the three architectures, over the main runs.

    None if there are none. Raises: as `Database.rows`.
    """
    better = {spec.name: spec.better for spec in published_metrics()}
    chosen = [
        universe
        for universe in universes(database, list(better), pools_seeds=True, progress=progress)
        if universe.architecture in PAPER_ARCHITECTURES and setting_of(universe) == main
    ]
    return (
        Multiverse(readings(), tuple(cells(chosen)), tuple(rankings(chosen, better)), tuple(chosen)) if chosen else None
    )


def relations_of(found: Multiverse | None) -> Relations:
    """Return the cells, the rankings and the readings as relations; none without a multiverse."""
    if found is None:
        return {}
    return {
        "reading_cells": arrow(found.cells, Cell),
        "reading_rankings": arrow(found.rankings, OrderUnderReadings),
        "readings": arrow(found.readings, Reading),
    }
