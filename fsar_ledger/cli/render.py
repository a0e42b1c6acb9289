"""Answer a verb's call: open its ledgers, show the answer in the form asked for, and warn of what it leaves open.

Warnings go to stderr before the answer goes to stdout.
"""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fsar_ledger import printable
from fsar_ledger.api.answers import Answer, Lines, provenances
from fsar_ledger.api.fields import Row
from fsar_ledger.api.verbs import Gives, Shows, Verb, declared
from fsar_ledger.printable import SafeText

from .progress import Progress
from .streaming import Form, Kept, answer_json
from .tables import fitted
from .terminal import has_keys, pause, say, show, width_of_names

if TYPE_CHECKING:
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.provenance import Provenance
    from fsar_ledger.api.walks import Steps


class Screen:
    """What an answer may know of its call, as `api.answers.Screen` says."""

    def __init__(self, ledger: "Ledger | None", asked: Collection[str], width: int | None) -> None:
        self._ledger = ledger
        self._asked = asked
        self._numbers: Mapping[str, int] | None = None
        self._width = width
        self._began_s = time.monotonic()

    @property
    def path(self) -> Path:
        """The folder of the ledger."""
        assert self._ledger is not None  # only answers about a ledger ask
        return self._ledger.path

    @property
    def elapsed_s(self) -> float:
        """Seconds since the call began."""
        return time.monotonic() - self._began_s

    def has(self, switch: str) -> bool:
        """Return whether the call has this switch."""
        return switch in self._asked

    @property
    def is_fitted(self) -> bool:
        """Whether tables are fitted to a terminal."""
        return self._width is not None

    def numbers(self) -> Mapping[str, int]:
        """Return the number of each run that has one, by its name."""
        if self._numbers is None:
            self._numbers = {} if self._ledger is None else self._ledger.numbers()
        return self._numbers

    def _number(self, run: str) -> int | None:
        """Return the number of a run, which may have come since the numbers were read."""
        if run not in self.numbers():
            self._numbers = None
        return self.numbers().get(run)

    def table(self, rows: Sequence[Row], columns: Sequence[str] | None = None) -> SafeText:
        """Return the rows as a table; None: with the columns of the first."""
        return fitted(rows, list(rows[0]) if columns is None else columns, self._width)

    def run_text(self, run: str) -> str:
        """Return the words that name a run: `run 12, NAME`; `run NAME` where it has no number."""
        number = self._number(run)
        return f"run {printable.value(run)}" if number is None else f"run {number}, {printable.value(run)}"

    def run_word(self, run: str) -> str:
        """Return what names the run in a command that people may copy: its number, where it has one."""
        number = self._number(run)
        return printable.word(run if number is None else number)

    def width_of_names(self, longest: int, beside: int) -> int:
        """Return the width of the column of names before words, in a line with so many columns beside both."""
        return width_of_names(longest, beside)


def _gift(what: str, clock: Callable[[], int]) -> object:
    if what == "now":
        return clock()
    if what == "walk":
        return _walk if has_keys() else None
    given = {"clock": clock, "ticks": time.monotonic, "pause": pause, "say": say, "show": show, "showing": Progress}
    return given[what]


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
    """Warn, a line each, of what runs do not observe, of missing planned runs, and of rows that were not compared."""
    from fsar_ledger.metrics.observing import told

    if (line := told(provenance.not_observed)) is not None:
        say(line)
    if provenance.plans is not None and (missing := provenance.plans.warning()) is not None:
        say(f"{ledger}: {missing}; `fsar-ledger info {printable.word(ledger)}` says how to go on")
    if not provenance.rows_verified:
        say(
            f"the rows of {ledger} were not compared with its root; `fsar-ledger verify {printable.word(ledger)}` does "
            "that, and --verified demands it"
        )


def respond(
    verb: Verb,
    given: dict[str, Any],
    ledgers: Sequence[str],
    form: Form,
    asked: Collection[str] = (),
    *,
    verified: bool,
    clock: Callable[[], int],
) -> int:
    """Answer the call, show the answer, and return the exit code. Raises: Whatever the verb raises.

    Args:
        verb: The verb.
        given: The values of its parameters, by name.
        ledgers: Which of the parameters are ledgers; they are opened.
        form: The form of the answer.
        asked: The switches that were given for its text.
        verified: Compare the rows of the ledgers with their roots first.
        clock: Gives the present time in seconds since 1970.
    """
    places = {name: given[name] for name in ledgers if given[name] is not None}
    held = {name: opened(place, verified=verified) for name, place in places.items()}
    screen = Screen(held.get("ledger"), asked, form.width)
    with ExitStack() as stack:
        for one in verb.parameters.values():
            beside = declared(one)
            if isinstance(beside, Shows):
                words = (other for switch, other in beside.instead.items() if given[switch])
                given[one.name] = stack.enter_context(Progress(next(words, beside.verb), beside.unit))
            elif isinstance(beside, Gives):
                given[one.name] = _gift(beside.what, clock)
        answer = verb.call(**given | held)
        for ledger in held.values():
            ledger.demanded  # noqa: B018 - compares the rows, had the verb not asked for them
    if not isinstance(answer, Answer | AbstractContextManager) and not hasattr(answer, "batches"):
        answer = Lines(str(answer))
    if isinstance(answer, AbstractContextManager):  # rows that come from a process, which may fail in their midst
        with answer as rows:
            pieces: Iterable[SafeText] = Kept(_pieces(rows, form, screen))
            answer = rows
    else:
        failure = answer.failure if isinstance(answer, Answer) else None
        pieces = [] if failure is not None and not form.as_json else _pieces(answer, form, screen)
    for place, provenance in zip(places.values(), provenances(answer), strict=False):
        warn(place, provenance)
    form.show(pieces)
    if isinstance(answer, Answer):
        if answer.failure is not None:
            raise answer.failure
        return answer.exit_code
    return 0


def _pieces(answer: Any, form: Form, screen: Screen) -> Iterable[SafeText]:
    if isinstance(answer, Answer):
        if form.as_json:
            document = answer.document(screen)
            first, *_ = (*provenances(answer), None)
            return [answer_json(first, document)]
        if not (form.as_csv or form.as_ndjson):
            return answer.text(screen)
        say(*answer.beside_rows())
        answer = answer.rows_alone()
    if form.as_json or form.as_csv or form.as_ndjson:
        return form.pieces(answer.provenance, answer.columns, answer.batches())
    pieces = form.pieces(answer.provenance, answer.columns_shown(), answer.batches(), screen.numbers)
    return chain(pieces, answer.below(screen))
