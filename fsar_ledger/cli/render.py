"""Answer a verb's call: open its ledgers, show the answer in the requested form, and warn of its gaps.

Warnings go to stderr before the answer goes to stdout. Answers of any length become text a few rows at a time, so that
memory does not grow with the answer.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from fsar_ledger.api.answers import Answer, Lines, Screen, provenance_json, provenances
from fsar_ledger.api.verbs import Gives, Shows, Verb, declared
from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.memory import temporary_files
from fsar_ledger.base.printable import SafeText

from .terminal import has_keys, pause, say, show, width_of_output

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.state import Steps
    from fsar_ledger.api.table import Rows
    from fsar_ledger.metrics.provenance import Provenance

KEPT_BYTES = 16 << 20
"""Text longer than this is buffered in an unnamed file, not in memory, until it is complete."""
PIECE = 1 << 20


class Form(msgspec.Struct, frozen=True, kw_only=True):
    """The form of an answer: JSON, a JSON object a line, CSV, or a table.

    A table has at most `limit` rows (0: all), and with `wide` every column.

    Raises:
        UsageError: Two forms at once, or --raw without --csv.
    """

    as_json: bool = False
    as_csv: bool = False
    as_ndjson: bool = False
    raw: bool = False
    limit: int = 0
    wide: bool = False

    def __post_init__(self) -> None:
        forms = {"--json": self.as_json, "--csv": self.as_csv, "--ndjson": self.as_ndjson}
        if len(chosen := [option for option, is_set in forms.items() if is_set]) > 1:
            raise UsageError(f"found {' and '.join(chosen)}, expected one of them")
        if self.raw and not self.as_csv:
            raise UsageError(
                "found --raw without --csv, expected both or neither; --json always gives the values themselves"
            )

    @property
    def is_for_programs(self) -> bool:
        """Return whether nothing may be printed beside the answer."""
        return self.as_json or self.as_csv or self.as_ndjson

    def screen(self, ledger: "Ledger | None" = None, asked: Collection[str] = ()) -> Screen:
        """Return the display context of an answer about this ledger, with these switches."""
        return Screen(ledger, asked, width_of_output(), is_wide=self.wide, limit=self.limit)

    def pieces(self, answer: Answer, screen: Screen) -> Iterable[SafeText]:
        """Return the answer in this form, as text.

        Raises:
            QueryFailed: Python cannot hold a date or time.
        """
        from fsar_ledger.api.table import Rows

        if self.as_json:
            about, *_ = (*provenances(answer), None)
            if isinstance(answer, Rows):
                beside = {"remarks": remarks} if (remarks := answer.beside_rows()) else {}
                return _json(answer_json(about, {**beside, answer.name: []}), answer)
            return [answer_json(about, answer.document(screen))]
        if not (self.as_csv or self.as_ndjson):
            return answer.text(screen)
        say(*answer.beside_rows())
        rows = answer.rows_alone()
        return _csv(rows, raw=self.raw) if self.as_csv else _ndjson(rows)


def answer_json(about: "Provenance | None", answer: Mapping[str, object]) -> SafeText:
    """Return one JSON object in ASCII: the provenance of the answer, then the answer.

    Bytes of a file name that are not UTF-8 are escaped, `\\udcff` for ff.
    """
    from fsar_ledger.api.texts import json_bytes

    if about is not None:
        answer = {**provenance_json(about), **answer}
    text = msgspec.json.format(json_bytes(msgspec.to_builtins(answer)), indent=2).decode()
    return printable.ascii_json(f"{text}\n")


def _json(empty: str, rows: "Rows") -> Iterator[SafeText]:
    from fsar_ledger.api.texts import in_turn, json_lines

    head, tail = empty.rsplit("[]", 1)
    is_first = True
    for lines in in_turn(partial(json_lines, before="    ", after=",\n"), filter(len, rows.batches())):
        yield SafeText((head + "[\n" if is_first else ",\n") + lines.removesuffix(",\n"))
        is_first = False
    yield SafeText(f"{head}[]{tail}" if is_first else f"\n  ]{tail}")


def _ndjson(rows: "Rows") -> Iterator[SafeText]:
    from fsar_ledger.api.texts import in_turn, json_lines

    return map(SafeText, in_turn(json_lines, rows.batches()))


def _csv(rows: "Rows", *, raw: bool) -> Iterator[SafeText]:
    from fsar_ledger.api.texts import csv_header, csv_lines, in_turn

    yield SafeText(csv_header(rows.columns, raw=raw))
    yield from map(SafeText, in_turn(partial(csv_lines, raw=raw), rows.batches()))


class Kept:
    """Text that is shown only once it is complete, so that a reader gets a whole answer or an error."""

    def __init__(self, pieces: Iterable[SafeText]):
        """Make all pieces now. Raises: As `pieces`; WriteFailed if they do not fit into the temporary folder."""
        self._file = tempfile.SpooledTemporaryFile(KEPT_BYTES)  # noqa: SIM115
        try:
            for piece in pieces:
                with temporary_files():
                    self._file.write(piece.encode("utf-8", "surrogatepass"))
        except BaseException:
            self._file.close()
            raise

    def __iter__(self) -> Iterator[SafeText]:
        """Yield the text, a few whole lines at a time; once."""
        with self._file as file:
            file.seek(0)
            while data := file.read(PIECE):
                yield SafeText((data + file.readline()).decode("utf-8", "surrogatepass"))


def _gift(what: str, clock: Callable[[], int]) -> object:
    if what == "now":
        return clock()
    if what == "walk":
        return _walk if has_keys() else None
    gifts = {"clock": clock, "ticks": time.monotonic, "pause": pause, "say": say, "show": show, "showing": Progress}
    return gifts[what]


def _walk(steps: "Steps", title: str) -> None:
    from .stepper import Stepper

    Stepper(steps, title).run()


def opened(ledger: Path, *, verified: bool) -> "Ledger":
    """Open the ledger; with `verified`, its rows are compared with the root when it is first read.

    Raises: As `demanded_head`, then.
    """
    from fsar_ledger.api.ledger import Ledger, demanded_head

    def compared() -> str | None:
        with Progress("verified", "segments") as progress:
            return demanded_head(ledger, verified=True, progress=progress)

    return Ledger(ledger, demanded=compared if verified else None)


def warn(ledger: Path, provenance: "Provenance") -> None:
    """Warn, a line each: of what is not observed, missing or open, and of rows that were not compared."""
    from fsar_ledger.metrics.provenance import unobserved_line

    if (line := unobserved_line(provenance.not_observed)) is not None:
        say(line)
    if provenance.plans is not None and (missing := provenance.plans.warning()) is not None:
        say(f"{ledger}: {missing}; `fsar-ledger info {printable.word(ledger)}` says how to continue")
    if provenance.open_work is not None:
        say(f"{provenance.open_work.warning()} (`fsar-ledger query open_work {printable.word(ledger)}`)")
    if provenance.actions_under_way:
        under_way = printable.counted(provenance.actions_under_way, "action")
        say(
            f"{under_way} under way when the record began: requests and permissions before that are not judged "
            f"(`fsar-ledger query actions_under_way {printable.word(ledger)}`)"
        )
    if not provenance.rows_verified:
        say(
            f"the rows of {ledger} were not compared with its root; `fsar-ledger verify {printable.word(ledger)}` "
            "compares them, as does --verified"
        )


def respond(
    verb: Verb,
    given: dict[str, Any],
    ledgers: Sequence[str],
    form: Form,
    asked: Collection[str] = (),
    drawn: Mapping[str, Path] = {},
    *,
    verified: bool,
    clock: Callable[[], int],
) -> int:
    """Answer the call, show the answer, and return the exit code. Raises: As the verb.

    Args:
        verb: The verb.
        given: The values of its parameters, by name.
        ledgers: Which of the parameters are ledgers; they are opened.
        form: The form of the answer.
        asked: The switches that were given for its text.
        drawn: The files to draw it to, by their formats.
        verified: Compare the rows of the ledgers with their roots first.
        clock: Gives the present time in seconds since 1970.
    """
    from fsar_ledger.ledger.store.paths import require_outside

    for kind, file in drawn.items():  # before any work
        require_outside(file, f"--{kind} {file}")
    paths = {name: given[name] for name in ledgers if given[name] is not None}
    open_ledgers = {name: opened(path, verified=verified) for name, path in paths.items()}
    screen = form.screen(open_ledgers.get("ledger"), asked)
    with ExitStack() as stack:
        for parameter in verb.parameters.values():
            declaration = declared(parameter)
            if isinstance(declaration, Shows):
                words = (other for switch, other in declaration.instead.items() if given[switch])
                given[parameter.name] = stack.enter_context(Progress(next(words, declaration.verb), declaration.unit))
            elif isinstance(declaration, Gives):
                given[parameter.name] = _gift(declaration.what, clock)
        answer = verb.call(**given | open_ledgers)
        for ledger in open_ledgers.values():
            ledger.demanded  # noqa: B018 - compares the rows, if the verb has not
    if isinstance(answer, AbstractContextManager):  # rows from a process, which may fail midway
        with answer as rows:
            pieces: Iterable[SafeText] = Kept(form.pieces(rows, screen))
            answer = rows
    else:
        answer = answer if isinstance(answer, Answer) else Lines(str(answer))
        for kind, file in drawn.items():
            answer.draw(file, kind)
        pieces = [] if answer.failure is not None and not form.as_json else form.pieces(answer, screen)
    for path, provenance in zip(paths.values(), provenances(answer), strict=False):
        warn(path, provenance)
    for piece in pieces:
        show(piece, raw=form.raw)
    if not form.is_for_programs:
        show(printable.lines(*map(str, drawn.values())))
    if answer.failure is not None:
        raise answer.failure
    return int(answer.exit_code)


LINE_END = "\n"
EVERY_S = 0.1
"""Seconds between two updates of the line."""


class Progress:
    """A line on stderr that is erased when the work ends; nothing if stderr is not a terminal that can erase it."""

    def __init__(self, verb: str, unit: str) -> None:
        """Begin work, named by a verb in the past tense and a unit: `simulated`, `batches`."""
        self._verb, self._unit = verb, unit
        self._is_shown = sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._bar: Bar | None = None
        self._last_s = time.monotonic()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def __call__(self, done: int, total: int) -> None:
        """Rewrite the line, unless it was written less than `EVERY_S` ago."""
        now_s = time.monotonic()
        if not self._is_shown or (now_s - self._last_s < EVERY_S and done < total):
            return
        self._last_s = now_s
        self._bar = self._bar or _bar(self._verb, self._unit)
        self._bar.update(self._bar.task_ids[0], completed=done, total=total)
        with self._bar.console.capture() as drawn:
            self._bar.console.print(self._bar.get_renderable())
        sys.stderr.write(f"\r\x1b[K{drawn.get().partition(LINE_END)[0]}")
        sys.stderr.flush()


def _bar(verb: str, unit: str) -> "Bar":
    """Return a progress bar of rich, which is imported only if the bar is visible.

    It is never started, only drawn: a started one has a thread, which forked processes would inherit, and hides the
    cursor, which stays hidden if the memory limit ends the process.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Task, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(TextColumn):
        """How many units are done per second."""

        def __init__(self) -> None:
            super().__init__("", markup=False)

        def render(self, task: Task) -> Text:
            return Text("" if task.speed is None else f"{task.speed:,.3g} per second")

    bar = Bar(
        TextColumn(f"{verb} {{task.completed:,.0f}} of {{task.total:,.0f}} {unit}", markup=False),
        BarColumn(20),
        Rate(),
        TimeRemainingColumn(compact=True),
        TextColumn("left", markup=False),
        console=Console(file=sys.stderr, highlight=False),
        get_time=time.monotonic,
        auto_refresh=False,
    )
    bar.add_task("")
    return bar
