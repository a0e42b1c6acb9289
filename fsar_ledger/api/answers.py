"""What every answer has: a document for programs, a text for people, an exit code, and what it holds for."""

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
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
"""Columns that lines of words keep for the words, whatever names stand before them."""


class Screen:
    """What an answer may know of the call that it answers.

    Args:
        ledger: The ledger, if the call is about one.
        switches: The switches that were given and that its verb declares beside its parameters.
        columns: The width of the terminal; None: the output is none.
        is_wide: Whether tables are whole, also on a terminal.
        limit: The most rows of an answer that can be long; 0: all.
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
        assert self._ledger is not None  # only answers about a ledger ask
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
        """Return the rows as a table; None: with the columns of the first."""
        from .tables import fitted

        return fitted(rows, list(rows[0]) if columns is None else columns, self.width)

    def numbers(self) -> Mapping[str, int]:
        """Return the number of each run that has one, by its name."""
        if self._numbers is None:
            self._numbers = {} if self._ledger is None else self._ledger.numbers()
        return self._numbers

    def _number(self, run: str) -> int | None:
        if run not in self.numbers():  # it may have come since they were read
            self._numbers = None
        return self.numbers().get(run)

    def run_text(self, run: str) -> str:
        """Return the words that name a run: `run 12, NAME`; `run NAME` where it has no number."""
        number = self._number(run)
        return f"run {printable.value(run)}" if number is None else f"run {number}, {printable.value(run)}"

    def run_word(self, run: str) -> str:
        """Return what names the run in a command that people may copy: its number, where it has one."""
        number = self._number(run)
        return printable.word(run if number is None else number)

    def event_word(self, run: str, seq: int) -> str:
        """Return what names an event in such a command, RUN:SEQ."""
        number = self._number(run)
        return printable.word(f"{run if number is None else number}:{seq}")

    def width_of_names(self, longest: int, beside: int) -> int:
        """Return the width of the column of names before words, in a line with so many columns beside both.

        It is that of the longest name, but on a terminal no more than leaves room for the words; longer names shift
        theirs.
        """
        return longest if self._columns is None else max(0, min(longest, self._columns - beside - ROOM))


class Answer:
    """What the answer of a verb has besides its fields, a struct's.

    One of these is `provenance`, or `provenances` if the answer is about several ledgers.
    """

    __slots__ = ()
    __struct_fields__: ClassVar[tuple[str, ...]]

    @property
    def exit_code(self) -> int:
        """The exit code of the command."""
        return 0

    @property
    def failure(self) -> FsarLedgerError | None:
        """The error with which the command ends, in place of a text; as JSON the document is shown first."""
        return None

    def document(self, screen: Screen) -> Mapping[str, object]:  # noqa: ARG002 - others name the ledger
        """Return what JSON says beside the provenance: all other fields, in their order."""
        return {name: getattr(self, name) for name in self.__struct_fields__ if name not in _STANDING}

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the answer as people read it."""
        raise NotImplementedError

    def table(self) -> "Table":
        """Return the rows, of an answer that has them. Raises: UsageError of another one."""
        raise UsageError(f"table: found {type(self).__name__}, which has no rows of one kind, expected its fields")

    def rows_alone(self) -> "Rows":
        """Return the rows as CSV has them."""
        return self.table()

    def beside_rows(self) -> list[str]:
        """Return the lines that are told on stderr where only rows can be shown."""
        return []

    def draw(self, file: "Place", kind: Any = None) -> None:
        """Draw an answer that can be drawn; `kind` is the format, where the suffix does not decide it."""
        raise NotImplementedError


def figure_place(file: "Place", kind: str | None) -> tuple[Path, str]:
    """Return where a figure goes and its format, svg or pdf: this kind, else that of the suffix.

    Raises:
        UsageError: Neither gives a format, or the file lies inside a ledger.
    """
    from fsar_ledger.ledger.store.paths import require_outside

    place = Path(file)
    form = place.suffix[1:] if kind is None else kind
    if form not in ("svg", "pdf"):
        raise UsageError(f"{place}: expected a name that ends in .svg or .pdf")
    require_outside(place, str(place))
    return place, form


class Lines(Answer):
    """An answer in a few lines, which JSON has by these names; `head` is that of a ledger that was written."""

    def __init__(self, *lines: str, **document: object) -> None:
        self._lines, self._document = lines, document
        self.provenances: tuple[Provenance, ...] = ()
        """What it holds for."""

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return what JSON says."""
        return self._document

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield the lines."""
        yield printable.lines(*self._lines)


class Plain(Answer):
    """An answer that is text as it is, such as a note or SQL; `refusal` is said where another form is asked for."""

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


def head_json(head: "Head") -> dict[str, object]:
    """Return what JSON says of a head."""
    return {"size": head.size, "root": head.root}


_STANDING = ("provenance", "provenances")


def provenances(answer: Any) -> "tuple[Provenance, ...]":
    """Return what an answer holds for, a provenance for each ledger; empty where it rests on none."""
    one = getattr(answer, "provenance", None)
    found: tuple[Provenance, ...] = getattr(answer, "provenances", () if one is None else (one,))
    return found
