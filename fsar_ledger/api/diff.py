"""The verb `diff`: how two runs differ, where they diverge and what led there, and how each ended."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted

from .answers import Answer, Screen
from .names import Place, Run
from .verbs import Option, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis import Line
    from fsar_ledger.analysis.difference import Difference, OutcomesDiff
    from fsar_ledger.events import Event
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

CHAIN = 6
"""Causes that are shown of one event; of a longer chain, the first and the last."""
MAX_PARAMETER = 60
"""Characters of a field of event 0; constants are long."""


class Parameter(msgspec.Struct, frozen=True):
    """A field of an event in which two runs differ, as text."""

    field: str
    first: str | None
    second: str | None


class DifferenceLine(msgspec.Struct, frozen=True):
    """A difference in words. `shift_s`: how much later the event is in the second run. Units: seconds of run time.

    None: the event is not in that run, or has no words there.
    """

    kind: str
    first_seq: int | None
    second_seq: int | None
    first_s: float | None
    second_s: float | None
    shift_s: float | None
    fields: str
    is_consequence: bool
    words: str


class FirstDifference(msgspec.Struct, frozen=True):
    """Where two runs diverge: the first event of each that is not the same in the other, with its chain of causes.

    Each chain begins with the event and goes back to a fact of the world; empty where all events of the run are the
    same in the other. `fields` are those that differ where both are the same event. Units: `at_s` seconds of run time;
    what a field named `_us` holds, microseconds.
    """

    at_s: float
    first: tuple["Line", ...]
    second: tuple["Line", ...]
    fields: tuple[Parameter, ...] = ()


class Diff(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """The differences of two runs.

    `same` events are the same at the same time; `counts` has the others by kind; `parameters` the fields of event 0
    that differ. `parting` and `consequences` are None where nothing but event 0 differs.
    """

    first: str
    second: str
    parameters: tuple[Parameter, ...]
    same: int
    counts: dict[str, int]
    differences: tuple[DifferenceLine, ...]
    parting: FirstDifference | None
    consequences: "OutcomesDiff | None"
    provenances: tuple["Provenance", ...]

    @property
    def is_same(self) -> bool:
        """Return whether the two do the same; event 0 may say otherwise of what they were made from."""
        return not self.differences

    def table(self) -> "Table":
        """Return a row for each difference, in order of time."""
        from .table import Table, of_structs

        return Table(of_structs(self.differences, DifferenceLine), self.provenances[0])

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield what the runs are, and how they diverge."""
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
            yield from diff_text(self, ("first", "second"), screen)
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
    """Show how two runs differ: where they diverge and why, and how each ended.

    Events are aligned by cause and content, so that one more event does not make all that follow differ. A run is the
    same, or an event happens in one only, or changed, or has another cause, or moved in time. Where they diverge, both
    events are shown with what caused them, back to a fact of the world.

    Raises:
        UsageError: There is no such run, or it is a plan.
    """
    from fsar_ledger.ledger.rows.runs import start_of

    from .lookup import ledgers_of, present, recorded

    ledgers = ledgers_of(ledger, other)
    found = [present(one) for one in ledgers]
    records = [
        recorded(one, view, run, is_whole=True)
        for one, (view, _), run in ((ledger, found[0], first), (ledgers[-1], found[-1], second))
    ]
    for record in records:
        start_of(record)
    return difference_of(records[0], records[1], tuple(provenance for _, provenance in found))


def difference_of(
    first: "LedgerRun", second: "LedgerRun", provenances: "tuple[Provenance, ...]", ends_us: int | None = None
) -> Diff:
    """Return the differences of two records.

    With `ends_us` the second ends then, before all has happened: nothing later of the first is compared, and of what
    the second came to no more is told than had come about.

    Raises: as `Database.rows`.
    """
    from fsar_ledger.analysis import lines_from
    from fsar_ledger.analysis.difference import FIRST, KINDS, SECOND, align, chain, outcomes_diff, until_the_end
    from fsar_ledger.ledger.rows.codec import encode_coded
    from fsar_ledger.metrics.database import from_table
    from fsar_ledger.runtime.forks import until

    whole, first = first, first if ends_us is None else until(first, ends_us)
    found = align(first, second)
    differing = [one for one in found.differences if (one.first_seq, one.second_seq) != (0, 0)]
    kinds = Counter(one.kind for one in differing)
    named = [msgspec.structs.replace(run, run_id=name) for name, run in ((FIRST, whole), (SECOND, second))]
    told: tuple[DifferenceLine, ...] = ()
    parting = after = None
    if differing:
        starts = _starts(differing)
        chains = [chain(run, seq) if seq is not None else [] for run, seq in zip((first, second), starts, strict=True)]
        with from_table(encode_coded(named)) as database:
            places = [(FIRST, one.first_seq) for one in differing if one.first_seq is not None]
            places += [(SECOND, one.second_seq) for one in differing if one.second_seq is not None]
            places += [(name, seq) for name, seqs in zip((FIRST, SECOND), chains, strict=True) for seq in seqs]
            lines = lines_from(database, places)
            after = outcomes_diff(database, whole, second, found.pairs)
        if ends_us is not None:
            after = until_the_end(after, ends_us)
        told = tuple(_line(one, first, second, lines) for one in differing)
        both = [tuple(lines[(name, seq)] for seq in seqs) for name, seqs in zip((FIRST, SECOND), chains, strict=True)]
        at_s = min(one.time_s for side in both for one in side[:1])
        parting = FirstDifference(at_s, both[0], both[1], _changed(first, second, starts, found.pairs))
    return Diff(
        first=first.run_id,
        second=second.run_id,
        parameters=_parameters(first.events[0], second.events[0]),
        same=found.same + (len(found.differences) > len(differing)),
        counts={kind: kinds[kind] for kind in KINDS if kinds[kind]},
        differences=told,
        parting=parting,
        consequences=after,
        provenances=provenances,
    )


def _starts(differing: "Sequence[Difference]") -> tuple[int | None, int | None]:
    """Return the first event of each run that is not the same in the other."""
    firsts = [one.first_seq for one in differing if one.first_seq is not None]
    seconds = [one.second_seq for one in differing if one.second_seq is not None]
    return min(firsts, default=None), min(seconds, default=None)


def _changed(
    first: "LedgerRun", second: "LedgerRun", starts: tuple[int | None, int | None], pairs: dict[int, int]
) -> tuple[Parameter, ...]:
    """Return the fields in which the first differing events differ, if they are the same event."""
    one, other = starts
    if one is None or other is None or pairs.get(one) != other:
        return ()
    return _parameters(first.events[one], second.events[other])


def _line(
    one: "Difference", first: "LedgerRun", second: "LedgerRun", lines: "dict[tuple[str, int], Line]"
) -> DifferenceLine:
    from fsar_ledger.analysis.difference import FIRST, SECOND

    words = [
        lines[place].text
        for place in ((FIRST, one.first_seq), (SECOND, one.second_seq))
        if place[1] is not None and place in lines
    ]
    return DifferenceLine(
        one.kind,
        one.first_seq,
        one.second_seq,
        None if one.first_seq is None else first.times_us[one.first_seq] / 1e6,
        None if one.second_seq is None else second.times_us[one.second_seq] / 1e6,
        None if one.shift_us is None else one.shift_us / 1e6,
        ", ".join(one.fields),
        one.is_consequence,
        " / ".join(dict.fromkeys(words)),
    )


def _parameters(first: "Event", second: "Event") -> tuple[Parameter, ...]:
    from fsar_ledger.events.envelope import flat

    firsts, seconds = flat(first), flat(second)
    return tuple(
        Parameter(name, _stored(firsts.get(name)), _stored(seconds.get(name)))
        for name in dict.fromkeys((*firsts, *seconds))
        if firsts.get(name) != seconds.get(name)
    )


def _stored(value: object) -> str | None:
    if isinstance(value, tuple):
        return "; ".join(map(str, value)) or "nothing"
    return None if value is None else str(value)


def diff_text(found: Diff, names: tuple[str, str], screen: Screen) -> Iterator[SafeText]:
    """Yield where two runs diverge and how they ended; `names` are the columns of the two."""
    if found.parting is None or found.consequences is None:
        yield printable.lines("no event differs")
        return
    counts = ", ".join(
        f"{kind.replace('first', names[0]).replace('second', names[1])} {count:,}"
        for kind, count in found.counts.items()
    )
    head = [f"{counted(found.same, 'event')} the same; {counts}", f"they diverge at {found.parting.at_s:.3f} s", ""]
    yield printable.lines(*head, *_parting(found.parting, names), "")
    yield _metrics(found.consequences, names, screen)
    yield _tasks(found.consequences, names, screen)
    yield _verdicts(found.consequences, names)


def _parting(found: FirstDifference, names: tuple[str, str]) -> Iterator[str]:
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
        return printable.lines("", "all tasks end alike" if found.tasks else "no task is on record in either")
    return printable.joined(printable.lines(""), screen.table(rows))


def _verdicts(found: "OutcomesDiff", names: tuple[str, str]) -> SafeText:
    told, others = (dict(zip(("first", "second"), each, strict=True)) for each in (names, names[::-1]))
    lines = [
        f"{'only ' if one.is_judged_in_both else ''}{told[one.run]}: {one.verdict} at {one.time_s:.3f} s, "
        + printable.value(one.what)
        + ("" if one.seq is None else f" (event {one.seq})")
        + ("" if one.is_judged_in_both else f"; {others[one.run]} does not observe what would tell")
        for one in found.verdicts
    ]
    return printable.lines("", *lines) if lines else printable.lines()


def _short(text: str | None) -> str:
    return "-" if text is None else printable.value(text, MAX_PARAMETER)
