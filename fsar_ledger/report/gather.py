"""Read the findings from one head of a ledger. No other module of the report asks queries about the results.

All numbers come from packaged queries through `fsar_ledger.metrics`; here they are only laid beside the paper's.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TypeAlias

from fsar_ledger.base.progress import Showing, unseen
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.comparability import differing_worlds
from fsar_ledger.metrics.database import Database, connect
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.multiverse import Multiverse
from fsar_ledger.metrics.plans import completeness
from fsar_ledger.metrics.results import MetricRow, metric_rows, models, setting_of, statistic_rows
from fsar_ledger.metrics.verdicts import Cell, Odds, odds
from fsar_ledger.report import all_readings, grades, printing, result_rows
from fsar_ledger.report.findings import (
    MAIN_CONFIGURATION,
    MAIN_FLEET_SIZE,
    Findings,
    Row,
    Source,
)
from fsar_ledger.report.other_ledgers import read_database, read_ledgers
from fsar_ledger.report.result_rows import cells_of, rule_of, scenarios_of, tests_of

QUERIES = (
    "metrics/metric_summary",
    "metrics/background",
    "statistics/pairwise_tests",
    "statistics/pooled_tests",
    "statistics/differing_worlds",
    "statistics/drawn_experiments",
    "staging/runs",
    "audit/experiments",
    "audit/unplanned_runs",
    "tables/architecture_features",
    "cases/case_claims",
)  # read directly; these read others

Setting: TypeAlias = tuple[str | None, int | None, int | None, str, str | None, str | None, str | None]
"""The setting that runs of one table share.

Configuration, fleet size, seed (None: all seeds), kind, source, model version and differing constants.
"""

SETTING = ("configuration", "fleet_size", "seed", "kind", "source", "model_version", "constants")
"""The names of its parts in `CHOSEN_SQL`."""

METRICS = tuple(spec.name for spec in published_metrics())

MAX_SPANS = 20
"""How many ranges of seeds a cell of a table lists."""

PAPER_RUNS = 20
"""Runs of each scenario in the paper's experiment."""
DRAWN_SQL = """
    SELECT metric, architecture, list(value ORDER BY draw) AS numbers
    FROM drawn_experiments
    WHERE
        configuration = $configuration AND fleet_size = $fleet_size
        AND ($seed IS NULL OR seed = $seed)
        AND kind = $kind
        AND source IS NOT DISTINCT FROM $source
        AND model_version IS NOT DISTINCT FROM $model_version
        AND constants IS NOT DISTINCT FROM $constants
    GROUP BY metric, architecture
"""
BACKGROUND_SQL = """
    SELECT * FROM background ORDER BY constants, seed, list_position(['fsar', 'cfc', 'dhma'], architecture)
"""
CASES_SQL = "SELECT * FROM case_claims"
CHOSEN_SQL = """
    SELECT runs.run_id
    FROM runs
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    WHERE
        runs.configuration = $configuration AND runs.fleet_size = $fleet_size
        AND ($seed IS NULL OR runs.seed = $seed)
        AND settings.kind = $kind
        AND runs.source IS NOT DISTINCT FROM $source
        AND runs.model_version IS NOT DISTINCT FROM $model_version
        AND settings.constants IS NOT DISTINCT FROM $constants
"""
OF_MAIN_SQL = f"""
    WITH chosen AS ({CHOSEN_SQL})
    SELECT runs.architecture, runs.scenario, count(*) AS runs
    FROM runs
    INNER JOIN chosen ON runs.run_id = chosen.run_id
    WHERE list_contains(['fsar', 'cfc', 'dhma'], runs.architecture)
    GROUP BY ALL
    ORDER BY ALL
"""
PAIRS_OF_MAIN_SQL = f"""
    WITH chosen AS ({CHOSEN_SQL})
    SELECT run_pairs.comparison, run_pairs.scenario, count(*) AS runs
    FROM run_pairs
    INNER JOIN chosen ON run_pairs.first_run_id = chosen.run_id
    WHERE run_pairs.differs IS NULL AND list_contains(['fsar-cfc', 'fsar-dhma', 'cfc-dhma'], run_pairs.comparison)
    GROUP BY ALL
    ORDER BY ALL
"""
RUNS_SQL = """
    SELECT
        configuration,
        fleet_size,
        architecture,
        count(DISTINCT scenario) AS scenarios,
        count(*) AS runs,
        list_sort(list_distinct(list(seed))) AS seeds,
        min(run) AS first,
        max(run) AS last
    FROM runs
    GROUP BY configuration, fleet_size, architecture
    ORDER BY configuration <> 'full', configuration, fleet_size, list_position(['fsar', 'cfc', 'dhma'], architecture)
"""


def _main(rows: Iterable[MetricRow]) -> Setting | None:
    """Return the setting of the report's tables: the full configuration with four robots.

    Among several, the one with the most runs; among equals, the first.
    """
    runs: Counter[Setting] = Counter()
    for row in rows:
        if (row.configuration, row.fleet_size) == (MAIN_CONFIGURATION, MAIN_FLEET_SIZE):
            runs[setting_of(row)] += row.n
    return max(runs, key=runs.__getitem__, default=None)


def _otherwise(setting: Setting, main: Setting | None) -> str | None:
    """Say in what these runs differ from the main ones beside configuration and fleet size; None if in nothing."""
    _, _, seed, kind, source, model_version, constants = setting
    said = (
        f"seed {seed}",
        kind,
        f"source {source}",
        f"model {model_version}",
        constants or "constants that do not vary",
    )
    ours = main or (None,) * len(setting)
    return (
        "; ".join(text for text, theirs, own in zip(said, setting[2:], ours[2:], strict=True) if theirs != own) or None
    )


def _odds(
    database: Database, main: Setting | None, runs_held: Mapping[str, Mapping[str | None, int]]
) -> Odds[Cell] | None:
    """Return how likely the printed table is among experiments drawn from the main runs.

    None if these are fewer than one such experiment.
    """
    if main is None or any(count < PAPER_RUNS for held in runs_held.values() for count in held.values()):
        return None
    drawn: dict[Cell, list[float | None]] = {}
    for row in database.rows(DRAWN_SQL, dict(zip(SETTING, main, strict=True))):
        drawn[row["metric"], row["architecture"]] = row["numbers"]
    return odds(drawn, verdicts.published())


def _background(rows: Iterable[Row]) -> tuple[Row, ...]:
    """Return, for each architecture, how much of the main runs' numbers is routine."""
    return tuple(
        row for row in rows if (row["configuration"], row["fleet_size"]) == (MAIN_CONFIGURATION, MAIN_FLEET_SIZE)
    )


def _of_setting(rows: Iterable[Row], main: Setting | None) -> list[Row]:
    """Keep the rows of the main setting; of every seed, if the tables are over all seeds."""
    if main is None:
        return []
    wanted = {name: value for name, value in zip(SETTING, main, strict=True) if name != "seed" or value is not None}
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def _others(rows: Iterable[MetricRow], main: Setting | None) -> tuple[Row, ...]:
    """Return one row for each other setting and architecture, with a column per metric."""
    found: dict[tuple[Setting, str | None], Row] = {}
    for row in rows:
        setting = setting_of(row)
        if setting != main:
            named = {"configuration": row.configuration, "fleet_size": row.fleet_size, "architecture": row.architecture}
            line = found.setdefault(
                (setting, row.architecture),
                {**named, "otherwise": _otherwise(setting, main), "n": 0, **dict.fromkeys(METRICS)},
            )
            line[row.metric] = row.mean
            line["n"] = max(line["n"], row.n)
    return tuple(found.values())


def _runs(database: Database) -> tuple[Row, ...]:
    rows = database.rows(RUNS_SQL)
    return tuple(row | {"seeds": _ranges(row["seeds"]), "numbers": _span(row["first"], row["last"])} for row in rows)


def _ranges(numbers: Iterable[int]) -> str:
    """Write integers as text, consecutive ones as a range: 1 to 3, 7."""
    spans: list[list[int]] = []
    for one in numbers:
        if spans and one == spans[-1][1] + 1:
            spans[-1][1] = one
        else:
            spans.append([one, one])
    told = [_span(low, high) for low, high in spans[:MAX_SPANS]]
    return ", ".join(
        told if len(spans) <= MAX_SPANS else [*told, f"and {printing.integer(len(spans) - MAX_SPANS)} more"]
    )


def _span(low: int, high: int) -> str:
    """Write the range of integers from `low` to `high`."""
    return str(low) if low == high else f"{low} to {high}"


def _models(database: Database, main: Setting | None) -> tuple[tuple[Row, ...], dict[str, str], str | None]:
    """Return the sets of constants in the ledger, that of the main runs by dotted name, and its SHA-256.

    Without main runs, the constants are those of the first run that records some.
    """
    found = models(database)
    ours = [one for one in found if main is not None and (one.source, one.model_version, one.constants) == main[4:]]
    rows: tuple[Row, ...] = tuple(
        {
            "model_version": one.model_version,
            "kind": one.kind,
            "runs": one.runs,
            "constants": one.constants,
            "parameters_sha256": one.sha256,
        }
        for one in found
    )
    said = next((one for one in ours or found if one.parameters), None)
    return rows, dict(printing.flat("", said.parameters if said else {})), said.sha256 if said else None


def _is_file(query: str) -> bool:
    """Tell whether the query is a packaged file; views of single event types are generated."""
    return files("fsar_ledger.queries").joinpath(f"{query}.sql").is_file()


def _sources(database: Database, more: Iterable[str]) -> tuple[Source, ...]:
    """Return the packaged queries that the report reads, and `more`, with everything that they read, by name."""
    needed = database.library.needs(database.library.find(name).relation for name in (*QUERIES, *more))
    ordered = sorted(needed, key=lambda query: query.name)
    return tuple(Source(name=query.name, sha256=query.sha256) for query in ordered if _is_file(query.name))


def gather(
    ledger: Path,
    workflows: Path | None = None,
    demanded: str | None = None,
    beside: Mapping[Path, str | None] | None = None,
    *,
    pools_seeds: bool = False,
    reads_every_way: bool = False,
    showing: Showing = unseen,
) -> Findings:
    """Return the findings of the ledger's present head and of the ledgers beside it.

    The tables are of one setting: configuration, fleet size, kind, model, constants and seed (all seeds with
    `pools_seeds`). With `demanded`, the head must have that newest record; `beside` says the same of each other ledger
    (None: any). `reads_every_way` adds the multiverse of readings, which costs as much as all other results together.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `fsar_ledger.metrics.database.connect`.
        QueryFailed: A packaged query fails on this ledger's data.
    """
    named = {**({} if workflows is None else {workflows: None}), **(beside or {})}
    told = read_ledgers(named, workflows, pools_seeds=pools_seeds)  # first: a mistaken path fails at once
    with connect(ledger, demanded=demanded) as database:
        head = database.head
        every, every_by_scenario = (metric_rows(database, one, pools_seeds=pools_seeds) for one in (False, True))
        main = _main(every)
        overall, by_scenario = ([row for row in rows if setting_of(row) == main] for rows in (every, every_by_scenario))
        tests = [row for row in statistic_rows(database, pools_seeds=pools_seeds) if setting_of(row) == main]
        held_here = _held(database, main)
        unjudged = result_rows.unjudged(*held_here)
        drawn = _odds(database, main, held_here[0])
        cells = cells_of(overall, unjudged, drawn)
        kinds, parameters, digest = _models(database, main)
        told = told.or_else(read_database(database, pools_seeds=pools_seeds))
        otherwise, runs = _others(every, main), _runs(database)
        graded, background = _of_main(ledger, demanded, database, main, alone=not otherwise)
        return Findings(
            commits=head.commits if head else 0,
            size=head.size if head else 0,
            root=head.root if head else "",
            run_count=sum(row["runs"] for row in runs),
            cells=cells,
            tests=tests_of(tests, unjudged),
            scenarios=scenarios_of(overall, by_scenario),
            rule=rule_of(cells),
            table_share=drawn.table if drawn is not None and not unjudged else None,
            others=otherwise,
            runs=runs,
            models=kinds,
            parameters=parameters,
            parameters_sha256=digest,
            sources=_sources(database, (*told.queries(), *(all_readings.queries() if reads_every_way else ()))),
            features=grades.features(graded, unjudged),
            evidence=tuple(graded),
            background=background,
            cases=result_rows.beside(_of_setting(database.rows(CASES_SQL), main)),
            completeness=completeness(database).sentence(),
            workflows=told.workflows,
            ablation=told.ablation,
            scaling=told.scaling,
            multiverse=_read(database, main, showing, pools_seeds=pools_seeds)
            if reads_every_way and not unjudged
            else None,
            mechanisms=told.mechanisms,
            model_version=main[5] if main else None,
            shown=_shown(main, otherwise),
            unjudged=result_rows.why_unjudged(*held_here),
            differing=tuple(map(str, differing_worlds(database))),
        )


def _read(database: Database, main: Setting | None, showing: Showing, *, pools_seeds: bool) -> Multiverse | None:
    """Return the multiverse of the runs that the tables are of."""
    if main is None:
        return None
    setting = dict(zip(SETTING, main, strict=True))
    with showing("read", "combinations of readings") as progress:
        return all_readings.multiverse_of(database, setting, pools_seeds=pools_seeds, progress=progress)


def _shown(main: Setting | None, others: tuple[Row, ...]) -> str | None:
    """Say which runs the tables are of, if the ledger holds others of the same configuration and fleet size.

    None if it does not.
    """
    if main is None or not any((row["configuration"], row["fleet_size"]) == main[:2] for row in others):
        return None
    _, _, seed, kind, source, model_version, constants = main
    named = (
        "all seeds" if seed is None else f"seed {seed}",
        f"{kind} runs",
        source,
        f"model {model_version}",
        constants,
    )
    return (
        f"The tables are of {', '.join(filter(None, named))}; runs made otherwise are never taken together with these."
    )


def _held(
    database: Database, main: Setting | None
) -> tuple[dict[str, dict[str | None, int]], dict[str, dict[str | None, int]]]:
    """Count the main runs by architecture and scenario, and their pairs by comparison and scenario."""
    if main is None:
        return {}, {}
    chosen = dict(zip(SETTING, main, strict=True))
    return result_rows.run_counts(database.rows(OF_MAIN_SQL, chosen), "architecture"), result_rows.run_counts(
        database.rows(PAIRS_OF_MAIN_SQL, chosen), "comparison"
    )


def _of_main(
    ledger: Path, demanded: str | None, database: Database, main: Setting | None, *, alone: bool
) -> tuple[list[Row], tuple[Row, ...]]:
    """Return the grades and the background of the main runs; empty if there are none.

    Other runs of the ledger do not count.
    """
    if main is None:
        return [], ()
    if alone and main[2] is not None:
        return grades.graded(database), _background(database.rows(BACKGROUND_SQL))
    chosen = database.table(CHOSEN_SQL, dict(zip(SETTING, main, strict=True)))
    with connect(ledger, demanded=demanded) as narrowed:
        narrowed.hold("chosen_runs", chosen)
        narrowed.prepare("SELECT * FROM run_started")
        seed = "* REPLACE (NULL::BIGINT AS seed)" if main[2] is None else "*"  # all seeds together
        narrowed.define(
            "runs",
            f"SELECT {seed} FROM ({narrowed.library.find('staging/runs').sql}) WHERE run_id IN (SELECT run_id FROM "
            "chosen_runs)",
        )
        return grades.graded(narrowed), _background(narrowed.rows(BACKGROUND_SQL))
