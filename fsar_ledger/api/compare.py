"""The verb `compare`: a paired table of any two sides, from one ledger or two."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from msgspec import structs

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import counted
from fsar_ledger.metrics.comparison_sides import LeftOut, Paired, Side, SideRow, chosen, paired, sides

from .answers import Answer, Screen, provenance_json
from .names import by_scenario, pools_seeds
from .verbs import ROWS, ByOption, FirstOption, OtherArgument, PoolOption, SecondOption, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

LEFT_OUT = {
    "facts": "did not meet the same facts of the world, although made under the same constants",
    "repeated": "cannot be told apart: one side has several runs of one seed, scenario and number",
    "unobserved": "are not known to have met the same world, because one of them does not observe it",
}
FAULTS = ("facts", "repeated")
"""Differences that no experiment makes on purpose, as in `statistics`."""


class Comparison(Answer, Paired, frozen=True, kw_only=True):
    """A `Paired` with both sides, and the provenance of each ledger."""

    sides: tuple[Side, Side]
    provenances: tuple["Provenance", ...]

    @property
    def exit_code(self) -> int:
        """1 if pairs are left out for a difference that no experiment makes on purpose."""
        return int(any(group.differs in FAULTS for group in self.left_out))

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return both sides, how their runs pair, and the rows."""
        first, second = ({"name": side.name, **structs.asdict(side)} for side in self.sides)
        other = self.provenances[1:]
        return {
            "other": provenance_json(other[0]) if other else None,
            "first": first,
            "second": second,
            "pairs": self.pairs,
            **{name: getattr(self, name) for name in Paired.__struct_fields__},
            "remarks": self.beside_rows(),
        }

    def table(self) -> "Table":
        """Return the rows as a table; its provenance is that of the first ledger."""
        from .table import Table, of_structs

        return Table(of_structs(self.rows, SideRow), self.provenances[0])

    def rows_alone(self) -> "Table":
        """Return the rows, with scenarios only if they distinguish rows."""
        from .table import Table

        whole = self.table()
        is_divided = any(row.scenario is not None for row in self.rows)
        return whole if is_divided else Table(whole.stored.drop_columns(["scenario"]), whole.provenance)

    def beside_rows(self) -> list[str]:
        """Return what is compared, what the numbers leave out, and how to read them."""
        return [*_pairing(self.sides, self), *_missing(self.sides, self), *_how_to_read(self)]

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield what is compared, the rows, and how to read them."""
        below = [*_missing(self.sides, self), *_how_to_read(self)]
        yield printable.lines(*_pairing(self.sides, self))
        if self.rows:
            dull = {"seed": self.seeds <= 1, "family_tests": True}
            table = self.rows_alone()
            yield printable.line("")
            yield screen.table(table.rows(), [name for name in table.columns if not dull.get(name)])
            yield printable.lines(*([""] if below else []))
        yield printable.lines(*below)


@verb(
    "compare out/ledger --first fsar --second cfc",
    "compare out/ledger --first fsar --second dhma --by scenario",
    "compare out/ledger out/large --first fsar --verified --json",
    takes=ROWS,
)
def compare(
    ledger: "Ledger",
    first: FirstOption = None,
    second: SecondOption = None,
    other: OtherArgument = None,
    by: ByOption = None,
    pool: PoolOption = None,
) -> Comparison:
    """Compare any two sides in pairs, from one ledger or two.

    A side is an architecture with its configuration, constants, model and fleet size.

    Runs are paired by seed, scenario and number. For each metric: both means, first minus second with its 95 %
    interval, the number of pairs that differ at all, p of the paired t-test, or of the exact sign test where few
    differ, Holm over these tests, and d_z. The degrees of freedom of the t-test are the differing pairs minus one;
    `statistics` counts all pairs, so its p differs. Containment and latency are ratios over all pairs. The answer also
    says how many pairs met the same facts of the world, how many only the same draws, and which constants differ.

    Raises:
        UsageError: A side does not exist, or both are the same events.
    """
    from fsar_ledger.metrics.provenance import of_outcomes

    from .lookup import ledgers_of

    per_scenario, pooled = by_scenario(by), pools_seeds(pool)
    ledgers = ledgers_of(ledger, other)
    paths = [str(ledger.path) for ledger in ledgers]
    with ExitStack() as stack:
        databases = [stack.enter_context(ledger.database()) for ledger in ledgers]
        both = chosen([sides(database) for database in databases], (first, second), paths)
        if len(databases) > 1 and both[0].side == both[1].side and databases[0].head == databases[1].head:
            raise UsageError(
                f"{' and '.join(paths)}: found the same events in both, and {both[0]} as both sides, expected two "
                "different ones"
            )
        comparison = paired(databases, both, pools_seeds=pooled, by_scenario=per_scenario)
        provenances = tuple(map(of_outcomes, databases))
        return Comparison(**structs.asdict(comparison), sides=both, provenances=provenances)


def _pairing(both: tuple[Side, Side], result: Paired) -> list[str]:
    """Return lines on what is compared, what the pairs share, and which constants differ."""
    first, second = both
    lines = [f"first: {_described(first)}", f"second: {_described(second)}"]
    if not result.pairs:
        other = "other " if result.left_out else ""
        lines.append(
            f"nothing to compare: no {other}runs of both sides have the same seed, scenario and number; "
            + (
                "simulate both sides alike"
                if first.named_count and second.named_count
                else "runs of a real fleet have none and form no pairs: `fsar-ledger metrics` shows each side, "
                "`fsar-ledger query metrics_by_period` each day"
            )
        )
        lines += [f"found {side.coverage_text()}" for side in both]
    else:
        lines.append(f"{counted(result.pairs, 'pair')} by seed, scenario and number: {_shared(both, result)}")
        if first.fleet_size != second.fleet_size:
            lines.append(
                f"the fleets differ in size ({first.fleet_size} and {second.fleet_size} robots): robots that are in "
                "both meet the same draws"
            )
    lines += [f"left out: {_left_out(group)}" for group in result.left_out]
    differing = [f"{constant.name}={constant.first_value} and {constant.second_value}" for constant in result.constants]
    unread = [side for side in both if side.parameter_set is None]
    constants = (
        f"constants that differ, first and second: {printable.list_few(differing)}"
        if differing
        else "no constants are on record"
        if len(unread) == len(both)
        else f"the constants are the same{' as far as they are on record' if unread else ''}"
    )
    return [*lines, constants]


def _described(side: Side) -> str:
    parts = (side.kind, side.source, side.model_version and f"model {side.model_version}")
    return f"{side}, {', '.join(printable.value(part) for part in parts if part)}"


def _shared(both: tuple[Side, Side], result: Paired) -> str:
    """Return how many pairs share their facts, only their draws, or only their seed."""
    first, second = both
    is_of_one_model = (
        first.kind == second.kind == "simulated"
        and first.model_version is not None
        and first.model_version == second.model_version
    )
    seed_alone = (
        "share seed, scenario and number, but not the facts; whether forks and workflows share draws is not compared"
        if is_of_one_model
        else "share only seed, scenario and number, because their models differ or are not on record"
    )
    parts = {
        "met the same facts of the world": result.same_facts,
        "share what was drawn, but not the facts, because their constants or robots differ": result.same_draws,
        seed_alone: result.same_seed,
    }
    return "; ".join(f"{count:,} {what}" for what, count in parts.items() if count)


def _left_out(group: LeftOut) -> str:
    example: dict[str, Any] = group.one
    scenario, first, second = (printable.value(str(example[name])) for name in ("scenario", "first", "second"))
    where = f"first under seed {example['seed']}, {scenario}, run {example['run']}: {first} and {second}"
    return f"{counted(group.pairs, 'pair')} that {LEFT_OUT[group.differs]}; {where}"


def _missing(both: tuple[Side, Side], result: Paired) -> list[str]:
    lines = []
    for side, alone, name in zip(both, (result.first_alone, result.second_alone), ("first", "second"), strict=True):
        nameless = side.run_count - side.named_count
        if result.pairs and alone:
            lines.append(no_partner(alone, name))
        if result.pairs and nameless:
            lines.append(
                f"{counted(nameless, 'run')} of the {name} side without seed, scenario, number or size "
                f"{'is' if nameless == 1 else 'are'} in no pair"
            )
    if result.pairs and result.absent:
        lines.append(
            f"no pair of runs has a value of {', '.join(result.absent)} on both sides: undefined, or not observed"
        )
    return lines


def no_partner(runs: int, which: str) -> str:
    """Return a line on the runs of one side that have no counterpart on the other."""
    return f"{counted(runs, 'run')} of the {which} side {'has' if runs == 1 else 'have'} no partner"


def _how_to_read(result: Paired) -> list[str]:
    """Return lines on how to read the numbers, and why some rows have none."""
    from fsar_ledger.metrics.definitions import metric_named

    if not result.rows:
        return []
    undefined = [row for row in result.rows if row.n and row.mean_difference is None]
    defined = [row for row in result.rows if row.n and row.mean_difference is not None]
    alike = [row for row in defined if not row.differing_pairs]
    even = [row for row in defined if row.differing_pairs and row.test is None]
    few = [row for row in result.rows if row.test == "sign" and metric_named(row.metric).scale != "yes-no"]
    lines = ["differences are first minus second; containment and latency are ratios over all pairs" + _holm(result)]
    if fewer := [row for row in result.rows if row.test == "paired t" and row.differing_pairs < row.n]:
        lines.append(
            "paired t: the degrees of freedom are the differing pairs minus one; `statistics` counts all pairs, so "
            f"its p differs: {_cells(fewer, result)}"
        )
    if any(row.metric == "human_intervention" for row in result.rows):
        lines.append("human_intervention is the share of runs that called the fleet supervisor")
    if undefined:
        lines.append(f"undefined on one side or both, so there is no difference: {_cells(undefined, result)}")
    if alike:
        lines.append(f"no pair differs, so there is no test: {_cells(alike, result)}")
    if even:
        lines.append(f"neither side is higher in any pair, so there is no test: {_cells(even, result)}")
    if few:
        lines.append(f"exact sign test, because few pairs differ or all by the same amount: {_cells(few, result)}")
    return lines


def _holm(result: Paired) -> str:
    """Describe which tests Holm adjusts together; empty if there is no test."""
    from fsar_ledger.metrics.definitions import published_metrics

    tested = [row for row in result.rows if row.p is not None]
    published = {metric.name for metric in published_metrics()}
    counts = sorted({row.family_tests for row in tested if row.metric in published})
    parts = [f"{counted(counts[0], 'test')} together"] if len(counts) == 1 else []
    if len(counts) > 1:
        parts.append(f"{counts[0]} to {counts[-1]} tests of a seed together")
    if any(row.metric not in published for row in tested):
        parts.append("separately each metric that the paper does not print")
    return f"; Holm adjusts {' and '.join(parts)}" if parts else ""


def _cells(rows: list[SideRow], result: Paired) -> str:
    """Return the metrics of these rows, each once, with its seeds unless these are all that it has."""
    seeds_of: dict[tuple[str, str | None], list[int | None]] = {}
    for row in rows:
        seeds_of.setdefault((row.metric, row.scenario), []).append(row.seed)
    cells = []
    for (metric, scenario), seeds in seeds_of.items():
        of_metric = {row.seed for row in result.rows if (row.metric, row.scenario) == (metric, scenario)}
        only = [] if {*seeds} == of_metric else [f"seed{'' if len(seeds) == 1 else 's'} {', '.join(map(str, seeds))}"]
        within = "; ".join(([] if scenario is None else [printable.value(scenario)]) + only)
        cells.append(f"{metric} ({within})" if within else metric)
    return printable.list_few(cells)
