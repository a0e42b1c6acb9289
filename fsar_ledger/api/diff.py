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
"""Causes shown of an event; of a longer chain, the first ones and the last."""
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

    Each chain begins with the event and goes back to a fact of the world; empty if all events of the run are the same
    in the other. `fields` are those that differ if both are the same event. Units: `at_s` seconds of run time; values
    of fields named `_us` microseconds.
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
        """Return whether both runs do the same; what they were made from, in event 0, may differ."""
        return not self.differences

    def table(self) -> "Table":
        """Return a row for each difference, in order of time."""
        from .table import Table, of_structs

        return Table(of_structs(self.differences, DifferenceLine), self.provenances[0])

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield what the runs are, and how they diverge."""
        head = [f"first: {printable.value(self.first)}", f"second: {printable.value(self.second)}"]
        head += [
            f"{parameter.field}: {_short(parameter.first)} and {_short(parameter.second)}"
            for parameter in self.parameters
            if not parameter.field.startswith("forked_from")
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
    beside={"lists": Option("--all", None, "Also list every difference, one per line.")},
)
def diff(
    ledger: "Ledger",
    first: Annotated[Run, argument("RUN", "The first run.", complete="runs")],
    second: Annotated[Run, argument("RUN2", "The second run.", complete="runs")],
    other: "Ledger | Place | None" = declare("LEDGER", "Another ledger, which holds the second run."),
) -> Diff:
    """Show how two runs differ: where they diverge and why, and how each ended.

    Events are aligned by cause and content, so that one more event does not make all later ones differ. An event is the
    same in both runs, happens in one only, changed, has another cause, or moved in time. Where the runs diverge, both
    events are shown with what caused them, back to a fact of the world.

    Raises:
        UsageError: There is no such run, or it is a plan.
    """
    from fsar_ledger.ledger.rows.runs import start_of

    from .lookup import ledgers_of, present, recorded

    ledgers = ledgers_of(ledger, other)
    present_states = [present(ledger) for ledger in ledgers]
    records = [
        recorded(source, view, run, is_whole=True)
        for source, (view, _), run in ((ledger, present_states[0], first), (ledgers[-1], present_states[-1], second))
    ]
    for record in records:
        start_of(record)
    return difference_of(records[0], records[1], tuple(provenance for _, provenance in present_states))


def difference_of(
    first: "LedgerRun", second: "LedgerRun", provenances: "tuple[Provenance, ...]", ends_us: int | None = None
) -> Diff:
    """Return the differences of two records.

    With `ends_us` the second ends then, before everything has happened: nothing later of the first is compared, and
    outcomes of the second are reported only as far as they had occurred.

    Raises: as `Database.rows`.
    """
    from fsar_ledger.analysis import lines_from
    from fsar_ledger.analysis.difference import FIRST, KINDS, SECOND, align, chain, outcomes_diff, until_the_end
    from fsar_ledger.ledger.rows.codec import encode_coded
    from fsar_ledger.ledger.rows.runs import until
    from fsar_ledger.metrics.database import from_table

    whole, first = first, first if ends_us is None else until(first, ends_us)
    alignment = align(first, second)
    differing = [
        difference for difference in alignment.differences if (difference.first_seq, difference.second_seq) != (0, 0)
    ]
    kinds = Counter(difference.kind for difference in differing)
    named = [msgspec.structs.replace(run, run_id=name) for name, run in ((FIRST, whole), (SECOND, second))]
    difference_lines: tuple[DifferenceLine, ...] = ()
    parting = outcomes = None
    if differing:
        starts = _starts(differing)
        chains = [chain(run, seq) if seq is not None else [] for run, seq in zip((first, second), starts, strict=True)]
        with from_table(encode_coded(named)) as database:
            keys = [(FIRST, difference.first_seq) for difference in differing if difference.first_seq is not None]
            keys += [(SECOND, difference.second_seq) for difference in differing if difference.second_seq is not None]
            keys += [(name, seq) for name, seqs in zip((FIRST, SECOND), chains, strict=True) for seq in seqs]
            lines = lines_from(database, keys)
            outcomes = outcomes_diff(database, whole, second, alignment.pairs)
        if ends_us is not None:
            outcomes = until_the_end(outcomes, ends_us)
        difference_lines = tuple(_line(difference, first, second, lines) for difference in differing)
        chain_lines = [
            tuple(lines[(name, seq)] for seq in seqs) for name, seqs in zip((FIRST, SECOND), chains, strict=True)
        ]
        at_s = min(line.time_s for side in chain_lines for line in side[:1])
        parting = FirstDifference(
            at_s, chain_lines[0], chain_lines[1], _changed(first, second, starts, alignment.pairs)
        )
    return Diff(
        first=first.run_id,
        second=second.run_id,
        parameters=_parameters(first.events[0], second.events[0]),
        same=alignment.same + (len(alignment.differences) > len(differing)),
        counts={kind: kinds[kind] for kind in KINDS if kinds[kind]},
        differences=difference_lines,
        parting=parting,
        consequences=outcomes,
        provenances=provenances,
    )


def _starts(differing: "Sequence[Difference]") -> tuple[int | None, int | None]:
    """Return the first event of each run that is not the same in the other."""
    firsts = [difference.first_seq for difference in differing if difference.first_seq is not None]
    seconds = [difference.second_seq for difference in differing if difference.second_seq is not None]
    return min(firsts, default=None), min(seconds, default=None)


def _changed(
    first: "LedgerRun", second: "LedgerRun", starts: tuple[int | None, int | None], pairs: dict[int, int]
) -> tuple[Parameter, ...]:
    """Return the fields in which the first differing events differ, if they are the same event."""
    first_seq, second_seq = starts
    if first_seq is None or second_seq is None or pairs.get(first_seq) != second_seq:
        return ()
    return _parameters(first.events[first_seq], second.events[second_seq])


def _line(
    difference: "Difference", first: "LedgerRun", second: "LedgerRun", lines: "dict[tuple[str, int], Line]"
) -> DifferenceLine:
    from fsar_ledger.analysis.difference import FIRST, SECOND

    texts = [
        lines[key].text
        for key in ((FIRST, difference.first_seq), (SECOND, difference.second_seq))
        if key[1] is not None and key in lines
    ]
    return DifferenceLine(
        difference.kind,
        difference.first_seq,
        difference.second_seq,
        None if difference.first_seq is None else first.times_us[difference.first_seq] / 1e6,
        None if difference.second_seq is None else second.times_us[difference.second_seq] / 1e6,
        None if difference.shift_us is None else difference.shift_us / 1e6,
        ", ".join(difference.fields),
        difference.is_consequence,
        " / ".join(dict.fromkeys(texts)),
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


def _parting(parting: FirstDifference, names: tuple[str, str]) -> Iterator[str]:
    for parameter in parting.fields:
        values = (
            f"{name} {_value(parameter.field, text)}"
            for name, text in zip(names, (parameter.first, parameter.second), strict=True)
        )
        yield f"the same event with another {printable.value(parameter.field.removesuffix('_us'))}: {', '.join(values)}"
    for name, lines in zip(names, (parting.first, parting.second), strict=True):
        if not lines:
            yield f"{name}: does nothing that the other does not"
            continue
        yield f"{name}:"
        for index, line in enumerate(_shortened(lines)):
            if line is None:
                yield f"{'':>24}  ..."
            else:
                yield f"{line.seq:>8} {line.time_s:>11.3f} s  {'' if not index else 'because '}{line.words}"


def _value(field: str, text: str | None) -> str:
    if text is None:
        return "-"
    return f"{int(text) / 1e6:.6f} s" if field.endswith("_us") else printable.value(text, 200)


def _shortened(lines: "Sequence[Line]") -> "list[Line | None]":
    if len(lines) <= CHAIN:
        return list(lines)
    return [*lines[: CHAIN - 1], None, lines[-1]]


def _metrics(outcomes: "OutcomesDiff", names: tuple[str, str], screen: Screen) -> SafeText:
    rows = [
        {
            "metric": row.metric,
            names[0]: row.first,
            names[1]: row.second,
            "difference": None if row.first is None or row.second is None else row.second - row.first,
        }
        for row in outcomes.metrics
    ]
    return screen.table(rows)


def _tasks(outcomes: "OutcomesDiff", names: tuple[str, str], screen: Screen) -> SafeText:
    differing = [
        task
        for task in outcomes.tasks
        if (task.first, task.first_s, task.due_s) != (task.second, task.second_s, task.second_due_s)
    ]
    is_due_alike = not any(task.first and task.second and task.due_s != task.second_due_s for task in differing)
    rows = [
        {
            "task": task.task_id,
            **(
                {"due_s": task.due_s if task.first else task.second_due_s}
                if is_due_alike
                else {f"{names[0]}_due_s": task.due_s}
            ),
            names[0]: task.first,
            f"{names[0]}_s": task.first_s,
            **({} if is_due_alike else {f"{names[1]}_due_s": task.second_due_s}),
            names[1]: task.second,
            f"{names[1]}_s": task.second_s,
        }
        for task in differing
    ]
    if not rows:
        return printable.lines("", "all tasks end alike" if outcomes.tasks else "no task is on record in either")
    return printable.joined(printable.lines(""), screen.table(rows))


def _verdicts(outcomes: "OutcomesDiff", names: tuple[str, str]) -> SafeText:
    sides, others = (dict(zip(("first", "second"), pair, strict=True)) for pair in (names, names[::-1]))
    lines = [
        f"{'only ' if row.is_judged_in_both else ''}{sides[row.run]}: {row.verdict} at {row.time_s:.3f} s, "
        + printable.value(row.what)
        + ("" if row.seq is None else f" (event {row.seq})")
        + ("" if row.is_judged_in_both else f"; {others[row.run]} does not observe what it rests on")
        for row in outcomes.verdicts
    ]
    return printable.lines("", *lines) if lines else printable.lines()


def _short(text: str | None) -> str:
    return "-" if text is None else printable.value(text, MAX_PARAMETER)
