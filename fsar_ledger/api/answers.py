"""The interface of all answers: a JSON document, text, an exit code, and the ledger heads they hold for."""

import signal
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.base.printable import SafeText

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.record import Head
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .names import Place
    from .table import Rows, Table

Row = Mapping[str, Any]
"""A row of an answer: its values by the names of the columns."""
ROOM = 40
"""Columns that a line of a name and words keeps for the words, however long the name is."""


class Screen:
    """The display context of a call: its ledger, switches and terminal.

    Args:
        ledger: The ledger, if the call is about one.
        switches: The given switches, of those that its verb declares beside its parameters.
        columns: The width of the terminal; None: the output is not a terminal.
        is_wide: Whether tables keep their full width on a terminal.
        limit: The maximum number of rows of an answer that can be long; 0: all.
    """

    def __init__(
        self,
        ledger: "Ledger | None" = None,
        switches: Collection[str] = (),
        columns: int | None = None,
        *,
        is_wide: bool = False,
        limit: int = 0,
    ) -> None:
        self._ledger, self._switches, self._columns = ledger, switches, columns
        self.width = None if is_wide else columns
        """The width that tables are fitted to; None if they are not."""
        self.limit = limit
        self._numbers: Mapping[str, int] | None = None
        self._began_s = time.monotonic()

    @property
    def path(self) -> Path:
        """The folder of the ledger."""
        assert self._ledger is not None  # only answers about a ledger use it
        return self._ledger.path

    @property
    def elapsed_s(self) -> float:
        """Seconds since the call began."""
        return time.monotonic() - self._began_s

    def has(self, switch: str) -> bool:
        """Return whether the call has this switch."""
        return switch in self._switches

    @property
    def is_fitted(self) -> bool:
        """Whether tables are fitted to a terminal."""
        return self.width is not None

    def table(self, rows: Sequence[Row], columns: Sequence[str] | None = None) -> SafeText:
        """Return the rows as a table, by default with the columns of the first row."""
        from .tables import fitted

        return fitted(rows, list(rows[0]) if columns is None else columns, self.width)

    def numbers(self) -> Mapping[str, int]:
        """Return the number of each numbered run by name."""
        if self._numbers is None:
            self._numbers = {} if self._ledger is None else self._ledger.numbers()
        return self._numbers

    def _number(self, run: str) -> int | None:
        if run not in self.numbers():  # it may have been added since they were read
            self._numbers = None
        return self.numbers().get(run)

    def run_text(self, run: str) -> str:
        """Return the text that names a run: `run 12, NAME`, or `run NAME` if it has no number."""
        number = self._number(run)
        return f"run {printable.value(run)}" if number is None else f"run {number}, {printable.value(run)}"

    def run_word(self, run: str) -> str:
        """Return the run's number, or its name if it has none, as a word of a command to copy."""
        number = self._number(run)
        return printable.word(run if number is None else number)

    def event_word(self, run: str, seq: int) -> str:
        """Return an event's RUN:SEQ as a word of a command to copy."""
        number = self._number(run)
        return printable.word(f"{run if number is None else number}:{seq}")

    def proof_hint(self, run: str, seq: int, what: str = "") -> str:
        """Return a hint with the command that proves an event; `what` describes the event."""
        call = f"fsar-ledger prove {printable.word(self.path)} {self.event_word(run, seq)}"
        return f"`{call}` proves event {seq}{what} to others"

    def width_of_names(self, longest: int, beside: int) -> int:
        """Return the width of the name column in a line of a name, words and `beside` other columns.

        It is that of the longest name, but on a terminal it leaves `ROOM` for the words; longer names shift their
        words.
        """
        return longest if self._columns is None else max(0, min(longest, self._columns - beside - ROOM))


class Answer:
    """The base class of the answers of verbs, most of which are structs.

    One field is `provenance`, or `provenances` if the answer is about several ledgers.
    """

    __slots__ = ()
    __struct_fields__: ClassVar[tuple[str, ...]]

    @property
    def exit_code(self) -> int:
        """The exit code of the command."""
        return 0

    @property
    def failure(self) -> FsarLedgerError | None:
        """The error that ends the command in place of text; with JSON, the document is printed first."""
        return None

    def document(self, screen: Screen) -> Mapping[str, object]:  # noqa: ARG002 - subclasses name the ledger
        """Return the JSON document without the provenance: all other fields, in order."""
        return {name: getattr(self, name) for name in self.__struct_fields__ if name not in _STANDING}

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the answer as people read it."""
        raise NotImplementedError

    def table(self) -> "Table":
        """Return the rows. Raises: UsageError if the answer has none."""
        raise UsageError(f"table: found {type(self).__name__}, which has no rows of one kind, expected its fields")

    def rows_alone(self) -> "Rows":
        """Return the rows for CSV."""
        return self.table()

    def beside_rows(self) -> list[str]:
        """Return the lines to print on stderr where the output holds only rows."""
        return []

    def draw(self, file: "Place", kind: Any = None) -> None:
        """Draw the answer as a figure; `kind` is the format, by default that of the suffix."""
        raise NotImplementedError


def figure_place(file: "Place", kind: str | None) -> tuple[Path, str]:
    """Return the path of a figure and its format, svg or pdf: `kind`, by default that of the suffix.

    Raises:
        UsageError: Neither gives a format, or the file lies inside a ledger.
    """
    from fsar_ledger.ledger.store.paths import require_outside

    path = Path(file)
    form = path.suffix[1:] if kind is None else kind
    if form not in ("svg", "pdf"):
        raise UsageError(f"{path}: expected a name that ends in .svg or .pdf")
    require_outside(path, str(path))
    return path, form


class Lines(Answer):
    """An answer of a few lines of text, with a JSON document; its `head` is that of the ledger written."""

    def __init__(self, *lines: str, **document: object) -> None:
        self._lines, self._document = lines, document
        self.provenances: tuple[Provenance, ...] = ()
        """The provenance of each ledger it is about."""

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the JSON document."""
        return self._document

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield the lines."""
        yield printable.lines(*self._lines)


class Plain(Answer):
    """An answer of plain text, such as a note or SQL; `refusal` is the error if another format is requested."""

    def __init__(self, text: str, refusal: str = "") -> None:
        self._text, self._refusal = text, refusal

    def document(self, _: Screen) -> Mapping[str, object]:
        """Refuse. Raises: UsageError."""
        raise UsageError(self._refusal)

    def table(self) -> "Table":
        """Refuse. Raises: UsageError."""
        raise UsageError(self._refusal)

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield the text."""
        yield SafeText(self._text)


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end what runs meanwhile as Ctrl-C does."""
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def head_json(head: "Head") -> dict[str, object]:
    """Return the JSON document of a head."""
    return {"size": head.size, "root": head.root}


def provenance_json(provenance: "Provenance") -> dict[str, object]:
    """Return the fields of a JSON document that say what an answer rests on, its head first."""
    verified = {} if provenance.rows_verified is None else {"rows_verified": provenance.rows_verified}
    return {"head": provenance.head and head_json(provenance.head), **verified, **provenance.answer()}


_STANDING = ("provenance", "provenances")


def provenances(answer: Any) -> "tuple[Provenance, ...]":
    """Return the provenances of an answer, one for each ledger; empty if it rests on none."""
    provenance = getattr(answer, "provenance", None)
    result: tuple[Provenance, ...] = getattr(answer, "provenances", () if provenance is None else (provenance,))
    return result
