"""The verb `diff`: in what two runs differ, and why; and how that is told."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted

from .answers import Answer, Screen
from .names import Place, Run
from .verbs import Option, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis.difference import OutcomesDiff
    from fsar_ledger.analysis.difference_text import DifferenceLine, FirstDifference, Parameter
    from fsar_ledger.analysis.records import Line
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

CHAIN = 6
"""Causes that are shown of one event; of a longer chain, the first and the last."""
MAX_PARAMETER = 60
"""Characters of a field of event 0; constants are long."""


class Diff(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """The differences of two runs.

    `same` events are the same at the same time; `counts` has the others by kind; `parameters` the fields of event 0
    that differ. `parting`, `outcomes_diff`: None where nothing but event 0 differs.
    """

    first: str
    second: str
    parameters: tuple["Parameter", ...]
    same: int
    counts: dict[str, int]
    differences: tuple["DifferenceLine", ...]
    parting: "FirstDifference | None"
    consequences: "OutcomesDiff | None"
    provenances: tuple["Provenance", ...]

    @property
    def is_same(self) -> bool:
        """Return whether the two do the same; event 0 may say otherwise of what they were made from."""
        return not self.differences

    def table(self) -> "Table":
        """Return a row for each difference, in order of time."""
        from fsar_ledger.analysis.difference_text import DifferenceLine

        from .table import Table, of_structs

        return Table(of_structs(self.differences, DifferenceLine), self.provenances[0])

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield what the runs are, and how they part."""
        head = [f"first: {printable.value(self.first)}", f"second: {printable.value(self.second)}"]
        head += [
            f"{one.field}: {_short(one.first)} and {_short(one.second)}"
            for one in self.parameters
            if not one.field.startswith("forked_from")
        ]
        yield printable.lines(*head)
        if self.is_same:
            yield printable.lines(f"the same {counted(self.same, 'event')} at the same times")
        else:
            yield from story(self, ("first", "second"), screen)
        if screen.has("lists") and not self.is_same:
            rows = self.table().rows()
            yield printable.lines("")
            yield screen.table(rows, [name for name in rows[0] if name != "is_consequence"])


@verb(
    "diff out/ledger 1 2",
    "diff out/ledger 1 4 --all",
    "diff out/ledger 1 1 --other out/large --verified --json",
    beside={"lists": Option("--all", None, "Also list every difference, one a line.")},
)
def diff(
    ledger: "Ledger",
    first: Annotated[Run, argument("RUN", "The first run.", complete="runs")],
    second: Annotated[Run, argument("RUN2", "The second run.", complete="runs")],
    other: "Ledger | Place | None" = declare("LEDGER", "Another ledger, which holds the second run."),
) -> Diff:
    """Say in what two runs differ: where they part and why, and what they came to.

    Events are aligned by cause and content, so that one more event does not make all that follow differ. A run is the
    same, or an event happens in one only, or changed, or has another cause, or moved in time. Where they part, both
    events are shown with what caused them, back to a fact of the world.

    Raises:
        UsageError: There is no such run.
    """
    from .lookup import ledgers_of, present, recorded

    ledgers = ledgers_of(ledger, other)
    found = [present(one) for one in ledgers]
    records = [
        recorded(one, view, run, is_whole=True)
        for one, (view, _), run in ((ledger, found[0], first), (ledgers[-1], found[-1], second))
    ]
    return difference_of(records[0], records[1], tuple(provenance for _, provenance in found))


def difference_of(
    first: "LedgerRun", second: "LedgerRun", provenances: "tuple[Provenance, ...]", ends_us: int | None = None
) -> Diff:
    """Return the differences of two records; with `ends_us` the second ends then, before all has happened.

    Raises: as `Database.rows`.
    """
    from fsar_ledger.analysis.difference_text import difference_text

    return Diff(**msgspec.structs.asdict(difference_text(first, second, ends_us)), provenances=provenances)


def story(found: Diff, names: tuple[str, str], screen: Screen) -> Iterator[SafeText]:
    """Yield how two runs part and what they came to; `names` are the columns of the two."""
    if found.parting is None or found.consequences is None:
        yield printable.lines("no event differs")
        return
    counts = ", ".join(
        f"{kind.replace('first', names[0]).replace('second', names[1])} {count:,}"
        for kind, count in found.counts.items()
    )
    head = [f"{counted(found.same, 'event')} the same; {counts}", f"they part at {found.parting.at_s:.3f} s", ""]
    yield printable.lines(*head, *_parting(found.parting, names), "")
    yield _metrics(found.consequences, names, screen)
    yield _tasks(found.consequences, names, screen)
    yield _verdicts(found.consequences, names)


def _parting(found: "FirstDifference", names: tuple[str, str]) -> Iterator[str]:
    for one in found.fields:
        values = (
            f"{name} {_value(one.field, text)}" for name, text in zip(names, (one.first, one.second), strict=True)
        )
        yield f"the same event with another {printable.value(one.field.removesuffix('_us'))}: {', '.join(values)}"
    for name, lines in zip(names, (found.first, found.second), strict=True):
        if not lines:
            yield f"{name}: does nothing that the other does not"
            continue
        yield f"{name}:"
        for at, line in enumerate(_shortened(lines)):
            if line is None:
                yield f"{'':>24}  ..."
            else:
                yield f"{line.seq:>8} {line.time_s:>11.3f} s  {'' if not at else 'because '}{line.words}"


def _value(field: str, text: str | None) -> str:
    if text is None:
        return "-"
    return f"{int(text) / 1e6:.6f} s" if field.endswith("_us") else printable.value(text, 200)


def _shortened(lines: "Sequence[Line]") -> "list[Line | None]":
    if len(lines) <= CHAIN:
        return list(lines)
    return [*lines[: CHAIN - 1], None, lines[-1]]


def _metrics(found: "OutcomesDiff", names: tuple[str, str], screen: Screen) -> SafeText:
    rows = [
        {
            "metric": one.metric,
            names[0]: one.first,
            names[1]: one.second,
            "difference": None if one.first is None or one.second is None else one.second - one.first,
        }
        for one in found.metrics
    ]
    return screen.table(rows)


def _tasks(found: "OutcomesDiff", names: tuple[str, str], screen: Screen) -> SafeText:
    rows = [
        {
            "task": one.task_id,
            "due_s": one.due_s,
            names[0]: one.first,
            f"{names[0]}_s": one.first_s,
            names[1]: one.second,
            f"{names[1]}_s": one.second_s,
        }
        for one in found.tasks
        if (one.first, one.first_s) != (one.second, one.second_s)
    ]
    if not rows:
        return printable.lines("", "all tasks end alike")
    return printable.joined(printable.lines(""), screen.table(rows))


def _verdicts(found: "OutcomesDiff", names: tuple[str, str]) -> SafeText:
    told = {"first": names[0], "second": names[1]}
    lines = [
        f"only {told[one.run]}: {one.verdict} at {one.time_s:.3f} s, {printable.value(one.what)}"
        + ("" if one.seq is None else f" (event {one.seq})")
        for one in found.verdicts
    ]
    return printable.lines("", *lines) if lines else printable.lines()


def _short(text: str | None) -> str:
    return "-" if text is None else printable.value(text, MAX_PARAMETER)
