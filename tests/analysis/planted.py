"""Plant edits into a copy of a record, each of which is one difference."""

from random import Random
from typing import NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.ledger.rows.codec import LedgerRun

IDENTITY = ("subject", "task_id", "robot", "failed_action", "window", "obstruction", "peer")
OF_NO_ROBOT = ("supervisor", "holder", "command", "issued_by")
"""What an event is about that is of no robot and no task."""


class Row(NamedTuple):
    """An event with a name that outlives the edits; `cause` is such a name."""

    name: int
    time_us: int
    cause: int | None
    event: Event


class Planted(NamedTuple):
    """The edited copy, and the kinds of the edits, with the seq in the original of what was edited (None: nothing)."""

    run: LedgerRun
    edits: list[tuple[str, int | None]]


def planted(run: LedgerRun, count: int, seed: int) -> Planted:
    """Return a copy with up to `count` edits, no two of which touch effects of the same cause."""
    draw = Random(seed)
    rows = [
        Row(seq, time_us, cause, event)
        for seq, (time_us, cause, event) in enumerate(zip(run.times_us, run.caused_by, run.events, strict=True))
    ]
    causes = {row.cause for row in rows}
    leaves = [row for row in rows if row.name not in causes and row.cause is not None]
    touched: set[int | None] = set()
    edits: list[tuple[str, int | None]] = []
    for number in range(count):
        kind = draw.choice(("only second", "only first", "changed", "moved"))
        if kind == "only second":
            under = draw.choice(rows)
            event = CommandRejected(command=f"Planted{number}", subject="nothing", reason="planted")
            rows.append(Row(-1 - number, under.time_us + draw.randrange(1, 10**7), under.name, event))
            edits.append((kind, None))
            continue
        row = draw.choice(leaves if kind != "changed" else rows[1 : len(run.events)])
        if row.cause in touched or row not in rows:
            continue
        place = rows.index(row)
        if kind == "only first":
            del rows[place]
        elif kind == "moved":
            rows[place] = row._replace(time_us=row.time_us + draw.randrange(1, 10**7))
        else:
            fields = [field.name for field in msgspec.structs.fields(type(row.event))]
            kept = IDENTITY if any(name in IDENTITY for name in fields) else OF_NO_ROBOT
            names = [name for name in fields if name not in kept and isinstance(getattr(row.event, name), str)]
            if not names:
                continue
            rows[place] = row._replace(
                event=msgspec.structs.replace(row.event, **{draw.choice(names): f"planted {number}"})
            )
        touched.add(row.cause)
        edits.append((kind, row.name))
    return Planted(_run(run.run_id, rows), edits)


def _run(run_id: str, rows: list[Row]) -> LedgerRun:
    """Return the rows as a record, in order of time; an effect never comes before its cause."""
    rows = sorted(rows, key=lambda row: row.time_us)
    seqs = {row.name: seq for seq, row in enumerate(rows)}
    return LedgerRun(
        run_id,
        [row.time_us for row in rows],
        [None if row.cause is None else seqs[row.cause] for row in rows],
        [row.event for row in rows],
    )
