"""The story of two runs that part, as lines: where, why, and what became of it. Nothing here prints."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from fsar_ledger import printable
from fsar_ledger.printable import Shown, counted

from .tables import table

if TYPE_CHECKING:
    from fsar_ledger.analysis.words import Line
    from fsar_ledger.api.diff import Diff, Parting

CHAIN = 6
"""Causes that are shown of one event; of a longer chain, the first and the last."""


def story(found: "Diff", names: tuple[str, str], *, wide: bool) -> Shown:
    """Return how two runs part and what they came to; `names` are the columns of the two."""
    if found.parting is None or found.consequences is None:
        return printable.lines("no event differs")
    counts = ", ".join(
        f"{kind.replace('first', names[0]).replace('second', names[1])} {count:,}"
        for kind, count in found.counts.items()
    )
    head = [f"{counted(found.same, 'event')} the same; {counts}", f"they part at {found.parting.at_s:.3f} s", ""]
    return printable.joined(
        printable.lines(*head, *_parting(found.parting, names), ""),
        _metrics(found, names, wide=wide),
        _tasks(found, names, wide=wide),
        _verdicts(found, names),
    )


def _parting(found: "Parting", names: tuple[str, str]) -> Iterator[str]:
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
                yield f"{line.seq:>8} {line.time_s:>11.3f} s  {'' if not at else 'because '}{_words(line)}"


def _value(field: str, text: str | None) -> str:
    if text is None:
        return "-"
    return f"{int(text) / 1e6:.6f} s" if field.endswith("_us") else printable.value(text, 200)


def _words(line: "Line") -> str:
    action = "" if line.action_id is None else f"{printable.value(line.action_id)}  "
    return action + printable.value(line.text, 1_000)


def _shortened(lines: "Sequence[Line]") -> "list[Line | None]":
    if len(lines) <= CHAIN:
        return list(lines)
    return [*lines[: CHAIN - 1], None, lines[-1]]


def _metrics(found: "Diff", names: tuple[str, str], *, wide: bool) -> Shown:
    assert found.consequences is not None
    rows = [
        {
            "metric": one.metric,
            names[0]: one.first,
            names[1]: one.second,
            "difference": None if one.first is None or one.second is None else one.second - one.first,
        }
        for one in found.consequences.metrics
    ]
    return table(rows, list(rows[0]), wide=wide)


def _tasks(found: "Diff", names: tuple[str, str], *, wide: bool) -> Shown:
    """Return the tasks that did not end alike."""
    assert found.consequences is not None
    rows = [
        {
            "task": one.task_id,
            "due_s": one.due_s,
            names[0]: one.first,
            f"{names[0]}_s": one.first_s,
            names[1]: one.second,
            f"{names[1]}_s": one.second_s,
        }
        for one in found.consequences.tasks
        if (one.first, one.first_s) != (one.second, one.second_s)
    ]
    if not rows:
        return printable.lines("", "all tasks end alike")
    return printable.joined(printable.lines(""), table(rows, list(rows[0]), wide=wide))


def _verdicts(found: "Diff", names: tuple[str, str]) -> Shown:
    assert found.consequences is not None
    told = {"first": names[0], "second": names[1]}
    lines = [
        f"only {told[one.run]}: {one.verdict} at {one.time_s:.3f} s, {printable.value(one.what)}"
        + ("" if one.seq is None else f" (event {one.seq})")
        for one in found.consequences.verdicts
    ]
    return printable.lines("", *lines) if lines else printable.lines()
