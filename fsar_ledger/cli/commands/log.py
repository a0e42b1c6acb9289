"""The command `log`: the timeline of a run, a line for each event."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import LedgerArgument, VerifiedOption, examples
from fsar_ledger.cli.terminal import pause, show, width_of_names
from fsar_ledger.errors import UsageError
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.api.table import Table

EXAMPLES = examples(
    "fsar-ledger log out/ledger",
    "fsar-ledger log out/ledger --from 10s --to 30s --robot B1",
    "fsar-ledger log out/ledger --run all --about requests,policy --json",
)
AFTER_INTERRUPTION = "what is shown stays committed, and nothing was changed"

UNKNOWN = "?"
MAX_WORDS = 1_000
BESIDE = 25
"""Characters of a line beside its action, names and words: seq, time and gaps."""
LOOK_EVERY_S = 0.5
"""Seconds between two looks for more commits."""


def log(
    ledger: LedgerArgument,
    run: Annotated[
        str | None,
        typer.Option(
            "--run", metavar="RUN", help="A run, or a part of its name; all: every run.", show_default="the first run"
        ),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="TIME",
            help="Only from this time on, within the run: 46.6, 46.6s or 46600ms.",
            show_default="0",
        ),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="TIME",
            help="Only before this time, which may be after the end of the run.",
            show_default="the end",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", metavar="ROBOT", help="Only events that name this robot.", show_default="all"),
    ] = None,
    about: Annotated[
        list[str] | None,
        typer.Option(
            "--about",
            metavar="CONCERN",
            help="Only events of these concerns, as in requests,policy; may be repeated.",
            show_default="all",
        ),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Show every run, then wait for more commits, until Ctrl-C.")
    ] = False,
    verified: VerifiedOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON object for each event, one a line.")] = False,
) -> None:
    """Show a run event by event: who told whom what, or did what, and when.

    The words are those of `explain`. A line has the number of the event in its run, the time in seconds, the action,
    who tells whom (one name for a robot's own deed, or what befell it), what, and what else the record says. `?` is
    not on record.
    """
    from fsar_ledger.api.log import ALL
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import json_rows

    if follow and run not in (None, ALL):
        raise UsageError(
            f"--follow and --run {run}: a run is committed whole, so nothing more of it comes; expected one of them"
        )
    if follow and verified:
        raise UsageError(
            "--follow and --verified: rows that come later cannot have been compared yet; expected one of them"
        )
    asked = opened(ledger, verified=verified)
    tables: Iterator[Table] = iter(
        asked.stream_log(since, until, robot, about, pause=(lambda: pause(LOOK_EVERY_S)) if follow else None)
        if follow or run == ALL
        else [asked.log(run, since, until, robot, about)]
    )
    lines = Lines(asked.numbers)
    for number, table in enumerate(tables):
        if number == 0:
            warn(ledger, table.provenance)
        for rows in table.parts():
            show(json_rows(rows) if as_json else lines.text(rows))
    if not (as_json or follow or lines.run):
        show(printable.line("no such events"))


class Lines:
    """The lines of one run after another, aligned with those before, each run under its number and name."""

    def __init__(self, numbers: Callable[[], Mapping[str, int]]) -> None:
        self.run: str | None = None
        self._read = numbers
        self._numbers: dict[str, int | None] = {}
        self._widths = (0, 0)

    def text(self, rows: Sequence[dict[str, Any]]) -> Shown:
        """Return the rows as lines, under the name of their run."""
        if not {row["run_id"] for row in rows} <= self._numbers.keys():  # plans have none
            self._numbers |= {**dict.fromkeys(row["run_id"] for row in rows), **self._read()}
        shown = [_shown(row) for row in rows]
        before = self._widths
        self._widths = (
            max([before[0], *(len(action) for action, _, _ in shown)]),
            max([before[1], *(len(names) for _, names, _ in shown)]),
        )
        return printable.lines(*self._lines(rows, shown))

    def _lines(self, rows: Sequence[dict[str, Any]], shown: Sequence[tuple[str, str, str]]) -> Iterator[str]:
        from fsar_ledger.cli.output import run_text

        of_action, longest = self._widths
        of_names = width_of_names(longest, BESIDE + of_action)
        for row, (action, names, words) in zip(rows, shown, strict=True):
            if row["run_id"] != self.run:
                yield from ([] if self.run is None else [""])
                self.run = row["run_id"]
                yield run_text(self.run, self._numbers[self.run])
                yield ""
            yield f"{row['seq']:>6} {row['time_s']:>10.3f} s  {action:<{of_action}}  {names:<{of_names}}  {words}"


def _shown(row: dict[str, Any]) -> tuple[str, str, str]:
    """Return the action, who tells whom, and the words with their note, as people see them."""
    sender, receiver, action = (
        None if row[name] is None else printable.value(row[name]) for name in ("sender", "receiver", "action_id")
    )
    names = sender or UNKNOWN
    if row["receiver"] != row["sender"] or sender is None:
        names = f"{names} -> {receiver or UNKNOWN}"
    note = "" if row["note"] is None else f"  ({printable.value(row['note'], MAX_WORDS)})"
    return action or "", names, printable.value(row["message"], MAX_WORDS) + note
