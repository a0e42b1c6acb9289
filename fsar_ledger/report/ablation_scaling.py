"""Lay a ledger's numbers beside the paper's tables "Ablation" and "Scaling", and judge those that can be judged.

Means, intervals and drawn experiments come from packaged queries. A table is made of runs with one set of constants;
only the two dials that the paper leaves open vary, and they become curves.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import msgspec

from fsar_ledger.events.configuration import CONFIGURATIONS, FULL
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import Database, Value
from fsar_ledger.metrics.definitions import metric_named, published_metrics
from fsar_ledger.metrics.odds import Printed, odds
from fsar_ledger.metrics.paper_numbers import Place, Table, printed
from fsar_ledger.metrics.plans import completeness
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.results import DialledRow, cost_rows, dialled_rows
from fsar_ledger.report import printing, run_shape
from fsar_ledger.report.findings import ARCHITECTURES, MAIN_FLEET_SIZE, Ablation, Row, Scaling, Told

QUERIES = (
    "metrics/metrics_by_dial",
    "metrics/coordination_cost",
    "statistics/drawn_experiments",
    "statistics/drawn_scenarios",
)
DIALLED = "without-shared-registry"
"""The configuration whose success is a curve over how often robots meet."""

PAPER_RUNS = 20
"""Runs of each scenario in the paper's experiments."""

Shape = tuple[str, str, int]
"""Architecture, configuration and fleet size."""

DRAWN_SQL = """
    SELECT architecture, metric, list(value ORDER BY draw) AS numbers
    FROM {relation}
    WHERE
        setting = $setting AND configuration = $configuration
        AND ($seed IS NULL OR seed = $seed)
    GROUP BY architecture, metric
"""


class Alike(NamedTuple):
    """What the runs of one table have in common; fleet size and dials may differ."""

    made_alike_but: str
    seed: int | None


def ablation_of(database: Database, *, pools_seeds: bool = False) -> Ablation | None:
    """Return the ablations that the ledger holds; None if it holds none."""
    if not _has(
        database,
        "architecture = 'fsar' AND fleet_size = 4 AND list_contains($configurations, configuration)",
        list(CONFIGURATIONS[1:]),
    ):
        return None
    rows = [
        row
        for row in dialled_rows(database, pools_seeds=pools_seeds)
        if (row.architecture, row.fleet_size) == ("fsar", MAIN_FLEET_SIZE)
    ]
    tables: dict[tuple[Alike, float | None], list[DialledRow]] = {}
    for row in rows:
        tables.setdefault((_alike(row), row.encounter_mean_s), []).append(row)
    ablated = {
        key: found for key, found in tables.items() if {row.configuration for row in found} & set(CONFIGURATIONS[1:])
    }
    if not ablated:
        return None
    alike, mean = max(
        ablated, key=lambda key: (len({row.configuration for row in ablated[key]}), sum(row.n for row in ablated[key]))
    )
    table = ablated[alike, mean]
    curve = [row for row in rows if _alike(row) == alike and row.configuration == DIALLED]
    return Ablation(
        _told(database, table[0]),
        mean,
        tuple(_judged(database, "ablation", table)),
        tuple(_judged(database, "ablation_text", table)),
        tuple(_plain(row) for row in sorted(curve, key=lambda row: row.encounter_mean_s or 0.0)),
        _wide(row for row in curve if row.scenario is None),
    )


def scaling_of(database: Database, *, pools_seeds: bool = False) -> Scaling | None:
    """Return the numbers of fleets of other sizes than four robots, with those of comparable fleets of four.

    None if the ledger holds no such fleet.
    """
    if not _has(database, "fleet_size <> 4 AND list_contains($configurations, configuration)", [FULL]):
        return None
    rows = [
        row
        for row in dialled_rows(database, pools_seeds=pools_seeds)
        if row.configuration == FULL and row.architecture in ARCHITECTURES
    ]
    sizes: dict[Alike, set[int]] = {}
    counts: Counter[Alike] = Counter()
    for row in rows:
        if row.fleet_size is not None and row.teams_working is not None:
            sizes.setdefault(_alike(row), set()).add(row.fleet_size)
            counts[_alike(row)] += row.n
    larger = [alike for alike, found in sizes.items() if found - {MAIN_FLEET_SIZE}]
    if not larger:
        return None
    alike = max(larger, key=lambda one: (len(sizes[one]), counts[one]))
    means = {row.encounter_mean_s for row in rows if _alike(row) == alike and row.fleet_size != MAIN_FLEET_SIZE}
    table = [row for row in rows if _alike(row) == alike and row.encounter_mean_s in means]
    return Scaling(
        _told(database, table[0]),
        tuple(_sized(database, table)),
        tuple(map(_plain, _over_all(table))),
        _costs(database, {row.setting for row in table}),
    )


def _costs(database: Database, settings: set[str]) -> tuple[Row, ...]:
    """Return what coordination costs in these settings, of the architectures in full, where all teams work."""
    return tuple(
        msgspec.structs.asdict(row)
        for row in cost_rows(database)
        if row.setting in settings
        and row.architecture in ARCHITECTURES
        and row.configuration == FULL
        and row.fleet_size is not None
        and row.teams_working == row.fleet_size // MAIN_FLEET_SIZE
    )


def _sized(database: Database, table: Sequence[DialledRow]) -> list[Row]:
    """Return the cells of the scaling table: fleets of four are judged, larger ones show both ends of the load."""
    ends = {
        "all": [row for row in table if row.fleet_size is not None and row.teams_working == row.fleet_size // 4],
        "one": [row for row in table if row.teams_working == 1],
    }
    cells = _judged(database, "scaling", ends["all"])
    ones = {_place_of("scaling", row): row for row in _over_all(ends["one"])}
    for cell in cells:
        one = ones.get(Place("scaling", cell["metric"], cell["architecture"], FULL, cell["fleet_size"]))
        cell |= {"one": None if one is None else one.mean, "one_interval": None if one is None else _interval(one)}
        cell["lies"] = _lies(cell)
    return cells


def _lies(cell: Row) -> str | None:
    """Say where the printed number lies relative to ours at the two ends of the load, within one margin.

    None where the ends coincide or we have only one of them.
    """
    if cell["mean"] is None or cell["one"] is None or cell["fleet_size"] == MAIN_FLEET_SIZE:
        return None
    low, high = sorted((cell["mean"], cell["one"]))
    margin = verdicts.MARGINS[cell["metric"]]
    return (
        "below both" if cell["paper"] < low - margin else "above both" if cell["paper"] > high + margin else "between"
    )


def _judged(database: Database, name: Table, table: Sequence[DialledRow]) -> list[Row]:
    """Return each printed number of a table beside ours.

    A number is not judged if the text leaves open what it depends on, or if the runs do not have the table's shape.
    """
    ours = {_place_of(name, row): row for row in table}
    runs = _runs(table)
    shares = _shares(database, name, [row for row in table if _place_of(name, row) in printed(name)], runs)
    cells: list[Row] = []
    for place, paper in printed(name).items():
        row, said = ours.get(place), registration().said_of(name, place._asdict())
        cell: Row = {
            **place._asdict(),
            "paper": paper.value,
            "class": said.kind.replace("_", " "),
            "because": said.because,
            "n": None if row is None else row.n,
        }
        cell |= {
            "paper_printed": _as_printed(place.metric, paper),
            "mean": None if row is None else row.mean,
            "interval": None if row is None else _interval(row),
        }
        cell |= dict.fromkeys(("difference", "distance", "gives", "share", "could"))
        # See docs/decisions/open-cells-have-no-verdict.md.
        if row is not None and row.mean is not None and said.dial is None and _is_shaped(place, runs):
            one = verdicts.judge(row, paper.value, shares.get(place))
            difference = None if one.low is None or one.high is None else (one.low, one.high)
            cell |= {
                "difference": difference,
                "distance": one.distance,
                "gives": one.gives,
                "share": one.share,
                "could": one.could,
            }
            if said.kind == "cannot_follow":  # the paper's own text answers
                cell |= {"gives": "no", "could": "no"}
        cells.append(cell)
    return cells


def _is_shaped(place: Place, runs: Mapping[Shape, run_shape.RunCounts]) -> bool:
    """Tell whether the runs match the printed number's: of its one scenario, or equally many of all."""
    return place.scenario is not None or run_shape.is_complete(
        runs.get((place.architecture, place.configuration, place.fleet_size), {})
    )


def _runs(table: Iterable[DialledRow]) -> dict[Shape, dict[str | None, int]]:
    """Return how many runs of each scenario each architecture, configuration and fleet size has."""
    found: dict[Shape, dict[str | None, int]] = {}
    for row in table:
        if row.scenario is not None:
            of_scenarios = found.setdefault((row.architecture or "", row.configuration or "", row.fleet_size or 0), {})
            of_scenarios[row.scenario] = max(of_scenarios.get(row.scenario, 0), row.n)
    return found


def _shares(
    database: Database, name: Table, rows: Sequence[DialledRow], runs: Mapping[Shape, run_shape.RunCounts]
) -> dict[Place, float]:
    """Return, for each cell, the share of experiments drawn from our runs that print a number as far out.

    Cells with fewer runs than the paper's experiment are left out.
    """
    said = registration()
    cells = {place: paper for place, paper in printed(name).items() if said.said_of(name, place._asdict()).dial is None}
    held = {place: runs.get((place.architecture, place.configuration, place.fleet_size), {}) for place in cells}
    enough = {place for place, found in held.items() if _count(found, place) >= PAPER_RUNS}
    drawn: dict[Place, list[float | None]] = {}
    for setting, size, seed in dict.fromkeys((row.setting, row.fleet_size or 0, row.seed) for row in rows):
        for scenario in dict.fromkeys(place.scenario for place in enough if place.fleet_size == size):
            relation = (
                "drawn_experiments"
                if scenario is None
                else f"(SELECT * FROM drawn_scenarios WHERE scenario = '{scenario}')"
            )
            for configuration in sorted(
                {place.configuration for place in enough if place.scenario == scenario}
            ):  # one by one: all draws at once are large
                chosen: dict[str, Value] = {"setting": setting, "seed": seed, "configuration": configuration}
                for found in database.rows(DRAWN_SQL.format(relation=relation), chosen):
                    place = Place(name, found["metric"], found["architecture"], configuration, size, scenario)
                    if place in enough:
                        drawn[place] = found["numbers"]
    told = odds(drawn, cells)
    return {} if told is None else told.cells


def _count(of_scenarios: run_shape.RunCounts, place: Place) -> int:
    """Return the smallest number of runs of a scenario that an experiment would be drawn from."""
    counts = of_scenarios if place.scenario is None else {place.scenario: of_scenarios.get(place.scenario, 0)}
    return min(counts.values(), default=0)


def _has(database: Database, condition: str, configurations: list[str]) -> bool:
    """Tell whether the ledger holds such runs, before anything is measured: most ledgers hold none."""
    found = database.rows(f"SELECT count(*) AS runs FROM runs WHERE {condition}", {"configurations": configurations})
    return int(found[0]["runs"]) > 0


def _told(database: Database, row: DialledRow) -> Told:
    head = database.head
    (runs,) = database.rows("SELECT count(*) AS runs FROM runs")
    said = (0, 0, "") if head is None else (head.commits, head.size, head.root)
    return Told(*said, runs["runs"], completeness(database).sentence(), row.model_version)


def _alike(row: DialledRow) -> Alike:
    return Alike(row.made_alike_but, row.seed)


def _place_of(table: Table, row: DialledRow) -> Place:
    """Return where the paper would print the number of this row."""
    return Place(table, row.metric, row.architecture or "", row.configuration or "", row.fleet_size or 0, row.scenario)


def _over_all(rows: Iterable[DialledRow]) -> list[DialledRow]:
    """Keep the rows over all scenarios whose runs cover all of them."""
    every = list(rows)
    shaped: dict[tuple[Shape, int | None], dict[str | None, int]] = {}
    for row in every:
        if row.scenario is not None:
            key = ((row.architecture or "", row.configuration or "", row.fleet_size or 0), row.teams_working)
            shaped.setdefault(key, {})[row.scenario] = max(row.n, shaped.get(key, {}).get(row.scenario, 0))
    return [
        row
        for row in every
        if row.scenario is None
        and run_shape.is_complete(
            shaped.get(((row.architecture or "", row.configuration or "", row.fleet_size or 0), row.teams_working), {})
        )
    ]


def _interval(row: DialledRow) -> tuple[float, float] | None:
    return None if row.ci_low is None or row.ci_high is None else (row.ci_low, row.ci_high)


def _as_printed(metric: str, paper: Printed) -> str:
    """Return the printed number in the report's unit, with as many digits as the paper gives."""
    scale = metric_named(metric).factor
    return printing.number(paper.value * scale, max(0, -round(math.log10(paper.step * scale))))


def _plain(row: DialledRow) -> Row:
    """Return a point of a curve."""
    return {
        **{
            name: getattr(row, name)
            for name in ("metric", "architecture", "configuration", "fleet_size", "scenario", "mean", "n")
        },
        **{name: getattr(row, name) for name in ("encounter_mean_s", "teams_working")},
        "interval": _interval(row),
    }


def _wide(rows: Iterable[DialledRow]) -> tuple[Row, ...]:
    """Return one row for each rate of encounters, with a column for each metric."""
    found: dict[float | None, Row] = {}
    for row in sorted(rows, key=lambda row: row.encounter_mean_s or 0.0):
        line = found.setdefault(
            row.encounter_mean_s,
            {"encounter_mean_s": row.encounter_mean_s, "n": 0, **{spec.name: None for spec in published_metrics()}},
        )
        line[row.metric] = row.mean
        line["n"] = max(line["n"], row.n)
    return tuple(found.values())
