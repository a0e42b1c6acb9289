"""Compare our numbers with those that the paper prints, and judge them by the registered rules.

All tables are treated alike: a place is where the paper prints a number, and ours is the mean of the runs of that
place. Runs are judged only if they have the shape of the paper's tables: all five scenarios, equally many runs of each.
A number that depends on a dial that the text leaves open is not judged; it gets the range over that dial.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import msgspec

from fsar_ledger.base.printable import counted, list_few
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import Place, Printed, Table, metric_named, printed
from fsar_ledger.metrics.registration import Declaration, registration
from fsar_ledger.metrics.results import MetricRow, of_all_seeds, same_setting, setting_of
from fsar_ledger.metrics.verdicts import Odds, odds

COMPARISONS = ("fsar-cfc", "fsar-dhma", "cfc-dhma")
FOUR_ROBOTS = 4
"""Fleet size of all tables of the paper but that of larger fleets."""
PAPER_RUNS = 20
"""Runs of each scenario in the paper's experiments."""

STANDS, FAILS, UNDECIDED, OPEN = "stands", "does not", "undecided", "open"
INFORMED, EXCLUDED, UNSPECIFIED = "informed", "cannot follow", "unspecified"
AIMED_AT = ("fitted", "count", "dial")  # classes of cells at which the fit aimed

RunCounts = Mapping[str | None, int]
"""The number of runs, or pairs of runs, of each scenario."""

Shape = tuple[str, str, int]
"""Architecture, configuration and fleet size."""

Ends = tuple[float, float]

DRAWN_SQL = f"""
    SELECT architecture, metric, list(value ORDER BY draw) AS numbers
    FROM {{relation}}
    WHERE {same_setting()}
    GROUP BY architecture, metric
"""


class Number(msgspec.Struct, frozen=True, kw_only=True, rename={"kind": "class"}):
    """One number that the paper prints, ours beside it, and the outcome. Units: those of the queries.

    `kind` is the registered class and `because` its reason; `printed` is as in the paper. `interval` (95 %) is of ours,
    `difference` (90 %) of ours minus paper, `distance` the same in margins; `reach` is its interval in margins, or the
    range over an open dial. `gives` and `could` answer the two registered questions, `share` is the p behind the
    second, `outcome` the result of both. `one` and `one_interval` are ours where one team of a larger fleet works,
    `ours` where all do; `lies` is where the paper's number is relative to these two.
    """

    table: str
    metric: str
    architecture: str
    configuration: str
    fleet_size: int
    scenario: str | None
    kind: str
    because: str | None
    printed: str
    paper: float
    ours: float | None
    n: int | None
    interval: Ends | None
    difference: Ends | None
    margin: float
    distance: float | None
    reach: Ends | None
    gives: str | None
    share: float | None
    could: str | None
    outcome: str
    denominator: int | None
    without_routine: float | None
    published_convention: float | None
    one: float | None = None
    one_interval: Ends | None = None
    lies: str | None = None


def ends(low: float | None, high: float | None) -> Ends | None:
    """Return the interval between these ends; None if either is missing."""
    return None if low is None or high is None else (low, high)


def place_of(table: Table, row: MetricRow) -> Place:
    """Return where the paper would print the number of this row."""
    return Place(table, row.metric, row.architecture or "", row.configuration or "", row.fleet_size or 0, row.scenario)


def shape_of(row: MetricRow | Place) -> Shape:
    """Return the architecture, configuration and fleet size of this row or place."""
    return row.architecture or "", row.configuration or "", row.fleet_size or 0


def run_counts(rows: Iterable[MetricRow]) -> dict[Shape, dict[str | None, int]]:
    """Return the number of runs of each scenario, by architecture, configuration and fleet size."""
    counts: dict[Shape, dict[str | None, int]] = {}
    for row in rows:
        if row.scenario is not None:
            of_scenarios = counts.setdefault(shape_of(row), {})
            of_scenarios[row.scenario] = max(of_scenarios.get(row.scenario, 0), row.n + row.runs_not_observed)
    return counts


def is_complete(runs: RunCounts) -> bool:
    """Return whether the runs cover every scenario of the tables equally often, and no other scenario."""
    return runs.keys() == set(PAPER_SCENARIOS) and len(set(runs.values())) == 1


def unjudged(runs: Mapping[str, RunCounts], pairs: Mapping[str, RunCounts]) -> frozenset[str]:
    """Return the architectures and comparisons whose runs do not have the shape of the paper's tables."""
    partial = {name for name, of_scenarios in runs.items() if not is_complete(of_scenarios)}
    return frozenset(
        partial
        | {
            name
            for name in COMPARISONS
            if partial & {*name.split("-")} or (name in pairs and not is_complete(pairs[name]))
        }
    )


def why_unjudged(runs: Mapping[str, RunCounts], pairs: Mapping[str, RunCounts]) -> str | None:
    """Return which runs the ledger has of what is not judged, in words; None if everything is judged."""
    not_judged = unjudged(runs, pairs)
    names_by_count: dict[str, list[str]] = {}
    for name in (architecture for architecture in PAPER_ARCHITECTURES if architecture in not_judged):
        names_by_count.setdefault(_listed(runs[name], "run"), []).append(name.upper())
    for name in COMPARISONS:
        if (
            name in not_judged and not {*name.split("-")} & not_judged
        ):  # otherwise the runs of its sides already explain it
            names_by_count.setdefault(_listed(pairs[name], "pair"), []).append(name.upper().replace("-", " vs "))
    if not names_by_count:
        return None
    of_each = "; ".join(f"of {list_few(names)} this ledger has {listed}" for listed, names in names_by_count.items())
    return (
        f"The printed tables are over {len(PAPER_SCENARIOS)} scenarios with equally many runs of each, but {of_each}. "
        "They are therefore shown without a verdict."
    )


def _listed(of_scenarios: RunCounts, what: str) -> str:
    return list_few(
        f"{counted(count, what)} of {name or 'no scenario'}"
        for name, count in sorted(of_scenarios.items(), key=lambda item: item[0] or "")
    )


def drawn_odds(database: Database, table: Table, rows: Sequence[MetricRow]) -> Odds[Place] | None:
    """Return how likely the printed numbers are among experiments of the paper's size, drawn from these runs.

    Places with fewer runs than that, and those on an open dial, are left out. Raises: as `Database.rows`.
    """
    runs, declared = run_counts(rows), registration().declaration_for
    places = {place: paper for place, paper in printed(table).items() if not is_open(declared(table, place._asdict()))}
    enough = {place for place in places if _fewest(runs.get(shape_of(place), {}), place) >= PAPER_RUNS}
    of_places = [row for row in rows if place_of(table, row) in enough]
    drawn: dict[Place, list[float | None]] = {}
    # One by one: all draws at once are large.
    for setting, scenario in dict.fromkeys((setting_of(row), row.scenario) for row in of_places):
        scenarios = f"(SELECT * FROM drawn_scenarios WHERE scenario = '{scenario}')"
        sql = DRAWN_SQL.format(relation="drawn_experiments" if scenario is None else scenarios)
        for row in database.rows(sql, of_all_seeds(setting)):
            shape = row["metric"], row["architecture"], setting[0] or "", setting[1] or 0
            if (place := Place(table, *shape, scenario)) in enough:
                drawn[place] = row["numbers"]
    return odds(drawn, places)


def _fewest(of_scenarios: RunCounts, place: Place) -> int:
    """Return the smallest number of runs of any scenario from which an experiment would be drawn."""
    counts = of_scenarios if place.scenario is None else {place.scenario: of_scenarios.get(place.scenario, 0)}
    return min(counts.values(), default=0)


def beside(
    table: Table,
    rows: Sequence[MetricRow],
    drawn: Odds[Place] | None,
    *,
    dial: Sequence[MetricRow] = (),
    ones: Sequence[MetricRow] = (),
    not_judged: Collection[str] = (),
) -> list[Number]:
    """Return every number of one table of the paper with ours, in the paper's order.

    Args:
        table: The table.
        rows: Our means, of runs that differ only in what the table varies.
        drawn: The odds of its numbers.
        dial: Our means at every position of the dial that the text leaves open.
        ones: Those where one team of a larger fleet works.
        not_judged: Architectures that get no verdict, in addition to those whose runs do not have the table's shape.
    """
    ours, of_one = ({place_of(table, row): row for row in means_of} for means_of in (rows, ones))
    runs, positions = run_counts(rows), _by_place(table, (*rows, *ones, *dial))
    numbers = []
    for place, paper in printed(table).items():
        declaration = registration().declaration_for(table, place._asdict())
        is_shaped = place.scenario is not None or is_complete(runs.get(shape_of(place), {}))
        number = _number(
            place,
            paper,
            declaration,
            ours.get(place),
            None if drawn is None else drawn.cells.get(place),
            is_judged=is_shaped and place.architecture not in not_judged,
        )
        if number.kind == UNSPECIFIED and (means := positions.get(place)):
            differences = [(mean - paper.value) / number.margin for mean in means]
            number = msgspec.structs.replace(number, reach=(min(differences), max(differences)))
        numbers.append(_at_both_ends(number, of_one.get(place)))
    return numbers


# See docs/decisions/open-cells-have-no-verdict.md.
def is_open(said: Declaration) -> bool:
    """Return whether a number depends on a dial that the text leaves open, and so gets a range and no verdict."""
    return said.kind.replace("_", " ") == UNSPECIFIED


def _by_place(table: Table, rows: Iterable[MetricRow]) -> dict[Place, list[float]]:
    means: dict[Place, list[float]] = {}
    for row in rows:
        if row.mean is not None:
            means.setdefault(place_of(table, row), []).append(row.mean)
    return means


def _number(
    place: Place,
    paper: Printed,
    declaration: Declaration,
    row: MetricRow | None,
    share: float | None,
    *,
    is_judged: bool,
) -> Number:
    """Return one number of the paper beside ours, judged if its runs are judged and it is not on an open dial."""
    kind, margin = declaration.kind.replace("_", " "), verdicts.MARGINS[place.metric]
    judged = None if row is None or row.mean is None or not is_judged else verdicts.judge(row, paper.value, share)
    if is_open(declaration):
        judged = None
    is_excluded = kind == EXCLUDED and judged is not None  # then the paper's own text decides
    difference = None if judged is None else ends(judged.low, judged.high)
    gives = "no" if is_excluded else None if judged is None else judged.gives
    return Number(
        **place._asdict(),
        kind=kind,
        because=declaration.because,
        printed=_as_printed(place.metric, paper),
        paper=paper.value,
        ours=None if row is None else row.mean,
        n=None if row is None else row.n,
        interval=None if row is None else ends(row.ci_low, row.ci_high),
        difference=difference,
        margin=margin,
        distance=None if judged is None else judged.distance,
        reach=None if difference is None else (difference[0] / margin, difference[1] / margin),
        gives=gives,
        share=None if judged is None else judged.share,
        could="no" if is_excluded else None if judged is None else judged.could,
        outcome=outcome_of(kind, gives),
        denominator=None if row is None else row.denominator,
        without_routine=None if row is None else row.mean_without_routine,
        published_convention=None if row is None else row.published_convention_mean,
    )


def outcome_of(kind: str, gives: str | None) -> str:
    """Return the outcome of a number of this class; what the paper's own text excludes does not stand."""
    if kind in (EXCLUDED, UNSPECIFIED):
        return FAILS if kind == EXCLUDED else OPEN
    return {"yes": STANDS, "no": FAILS}.get(gives or "", UNDECIDED)


def _at_both_ends(number: Number, row: MetricRow | None) -> Number:
    """Return the number with ours for one working team, and where the paper's lies relative to both, by a margin."""
    if row is None:
        return number
    lies = None
    if number.ours is not None and row.mean is not None and number.fleet_size != FOUR_ROBOTS:
        low, high = sorted((number.ours, row.mean))
        is_below, is_above = number.paper < low - number.margin, number.paper > high + number.margin
        lies = "below both" if is_below else "above both" if is_above else "between"
    return msgspec.structs.replace(number, one=row.mean, one_interval=ends(row.ci_low, row.ci_high), lies=lies)


def _as_printed(metric: str, paper: Printed) -> str:
    """Return the printed number in the report's unit, with the paper's number of digits."""
    scale = metric_named(metric).factor
    return f"{paper.value * scale:.{max(0, -round(math.log10(paper.step * scale)))}f}"
