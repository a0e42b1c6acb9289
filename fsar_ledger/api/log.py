"""The verb `log`: the timeline of a run, a line for each event."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Screen
from .names import Names, Run, Time
from .verbs import Gives, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

ALL = "all"
"""The name that selects all runs."""
UNKNOWN = "?"
MAX_WORDS = 1_000
BESIDE = 25
"""Characters of a line beside its action, names and words: seq, time and gaps."""
LOOK_EVERY_S = 0.5
"""Seconds between two checks for more commits."""


class Timeline(Answer):
    """Lines of events in the order they are read, one run after another."""

    def __init__(self, tables: "Iterable[Table]", *, as_json: bool, ends: bool) -> None:
        """Read the first table. `ends`: whether the lines end, so that having none can be reported."""
        rest = iter(tables)
        first = next(rest, None)
        self._tables = chain([] if first is None else [first], rest)
        self._as_json, self._ends = as_json, ends
        self.provenances: tuple[Provenance, ...] = () if first is None else (first.provenance,)

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the lines, or a JSON object for each."""
        if self._as_json:
            from .texts import json_lines

            yield from (SafeText(json_lines(batch)) for table in self._tables for batch in table.batches())
            return
        lines = Lines(screen)
        yield from (lines.text(rows) for table in self._tables for rows in table.parts())
        if self._ends and lines.run is None:
            yield printable.line("no matching events")


def _requested_log(
    ledger: "Ledger",
    run: Run | None,
    since: Time,
    until: Time,
    robot: str | None,
    about: Names,
    follow: bool = switch("Show every run, then wait for more commits, until Ctrl-C."),
    as_json: bool = switch("Show each event as a JSON object, one per line.", flag="--json"),
    pause: Annotated[Callable[[float], None] | None, Gives("pause")] = None,
) -> Timeline:
    if follow and run not in (None, ALL):
        raise UsageError(
            f"--follow and --run {run}: --follow shows the events of all runs as they come; expected one of them"
        )
    if follow and ledger.demands:
        raise UsageError(
            "--follow and --verified: rows that come later cannot have been compared yet; expected one of them"
        )
    tables: Iterable[Table] = (
        stream_log(ledger, since, until, robot, about, pause=partial(pause, LOOK_EVERY_S) if follow and pause else None)
        if follow or run == ALL
        else [log(ledger, run, since, until, robot, about)]
    )
    return Timeline(tables, as_json=as_json, ends=not follow)


@verb(
    "log out/ledger",
    "log out/ledger --from 10s --to 30s --robot B1",
    "log out/ledger --run all --about requests,policy --json",
    takes=("verified",),
    call=_requested_log,
    after_interruption="the events shown are committed, and nothing was changed",
)
def log(
    ledger: "Ledger",
    run: Run | None = declare("RUN", "A run, or a part of its name; all: every run.", "the first run"),
    since: Time = declare(
        "TIME",
        "Only from this time on, within the run: 46.6, 46.6s or 46600ms, or 2026-03-01T10:00Z if it has an epoch.",
        "0",
        flag="--from",
    ),
    until: Time = declare(
        "TIME", "Only before this time, which may be after the end of the run.", "the end", flag="--to"
    ),
    robot: str | None = declare("ROBOT", "Only events that name this robot.", "all"),
    about: Names = declare(
        "CONCERN", "Only events of these concerns, such as requests,policy; may be repeated.", "all"
    ),
) -> "Table":
    """Show a run event by event: who told whom what, or did what, and when.

    A run that continues another one is shown from the cut on, numbered as one run with it; without --run, all of it is
    shown.

    The words are those of `explain`. A line has the number of the event in its run, the time in seconds, the action,
    who tells whom (one name if a robot acts alone, or something happens to it), what, and what else the record says.
    `?` means not on record.

    Raises:
        UsageError: There is no such run, robot or concern, the run has ended before `since`, or `until` is not after
            `since`.
    """
    from .events import asked_of, timeline

    if run == ALL:
        with ledger.database() as database:
            return timeline(database, asked_of(database, ALL, since, until, robot, about))
    with ledger.about_run(run) as (database, name, _):
        since = _beginning(database) if run is not None and since is None and until is None else since
        return timeline(database, asked_of(database, name, since, until, robot, about))


def _beginning(database: "Database") -> Time:
    """Return when the run begins, if it continues another one."""
    [row] = database.rows("SELECT max(time_us) AS time_us FROM run_continued")
    return None if row["time_us"] is None else f"{row['time_us'] / 1_000_000:.6f}"


def stream_log(
    ledger: "Ledger",
    since: Time = None,
    until: Time = None,
    robot: str | None = None,
    about: str | Sequence[str] | None = None,
    *,
    pause: Callable[[], None] | None = None,
) -> "Iterator[Table]":
    """Yield the lines of all runs, as `log`, a table for each commit; with `pause`, go on as the ledger grows.

    `pause` is called before each check for more commits, to wait; None: end after the present ones. The others are as
    in `log`.

    Raises:
        UsageError: As `log`; or `pause` is given, but the ledger demands rows that were compared with the root.
        LedgerCorrupted: The ledger was damaged or replaced.
    """
    from .events import about_of, asked_of, stream

    if pause is not None and ledger.demanded is not None:
        raise UsageError(
            "rows that will be committed later cannot have been compared with the root yet: expected a ledger opened "
            "without that demand, or no wait for more"
        )
    with ledger.database() as database:
        request = asked_of(database, ALL, since, until, robot, about, is_growing=pause is not None)
        provenance = about_of(database, request)
    return stream(ledger.path, request, provenance, ledger.demanded, pause)


class Lines:
    """A formatter of lines, run after run, aligned with earlier lines, each run under its number and name."""

    def __init__(self, screen: Screen) -> None:
        self.run: str | None = None
        self._screen = screen
        self._widths = (0, 0)

    def text(self, rows: Sequence[dict[str, Any]]) -> SafeText:
        """Return the rows as lines, under the name of their run."""
        texts = [_row_texts(row) for row in rows]
        previous = self._widths
        self._widths = (
            max([previous[0], *(len(action) for action, _, _ in texts)]),
            max([previous[1], *(len(names) for _, names, _ in texts)]),
        )
        return printable.lines(*self._lines(rows, texts))

    def _lines(self, rows: Sequence[dict[str, Any]], texts: Sequence[tuple[str, str, str]]) -> Iterator[str]:
        action_width, longest = self._widths
        names_width = self._screen.width_of_names(longest, BESIDE + action_width)
        for row, (action, names, words) in zip(rows, texts, strict=True):
            if row["run_id"] != self.run:
                yield from ([] if self.run is None else [""])
                self.run = row["run_id"]
                yield self._screen.run_text(self.run)
                yield ""
            when = f"{row['time_s']:>10.3f} s" if row["clock"] is None else row["clock"]
            yield f"{row['seq']:>6} {when}  {action:<{action_width}}  {names:<{names_width}}  {words}"


def _row_texts(row: dict[str, Any]) -> tuple[str, str, str]:
    """Return the action, who tells whom, and the words with their note, as printable text."""
    sender, receiver, action = (
        None if row[name] is None else printable.value(row[name]) for name in ("sender", "receiver", "action_id")
    )
    names = sender or UNKNOWN
    if row["receiver"] != row["sender"] or sender is None:
        names = f"{names} -> {receiver or UNKNOWN}"
    note = "" if row["note"] is None else f"  ({printable.value(row['note'], MAX_WORDS)})"
    return action or "", names, printable.value(row["message"], MAX_WORDS) + note
