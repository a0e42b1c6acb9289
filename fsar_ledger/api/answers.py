"""What every answer has: a document for programs, a text for people, an exit code, and what it holds for."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from fsar_ledger import printable
from fsar_ledger.errors import FsarLedgerError, option

if TYPE_CHECKING:
    from fsar_ledger.printable import SafeText

    from .fields import Row
    from .names import Place
    from .provenance import Provenance
    from .table import Table


class Screen(Protocol):
    """What an answer may know of the call that it answers: the ledger, as it was named, and the room there is."""

    @property
    def path(self) -> Path:
        """The folder of the ledger."""

    @property
    def elapsed_s(self) -> float:
        """Seconds since the call began."""

    def has(self, switch: str) -> bool:
        """Return whether the call has this switch, which its verb declares beside its parameters."""

    @property
    def is_fitted(self) -> bool:
        """Whether tables are fitted to a terminal."""

    def table(self, rows: "Sequence[Row]", columns: Sequence[str] | None = None) -> "SafeText":
        """Return the rows as a table; None: with the columns of the first."""

    def numbers(self) -> Mapping[str, int]:
        """Return the number of each run that has one, by its name."""

    def run_text(self, run: str) -> str:
        """Return the words that name a run: `run 12, NAME`; `run NAME` where it has no number."""

    def run_word(self, run: str) -> str:
        """Return what names the run in a command that people may copy: its number, where it has one."""

    def width_of_names(self, longest: int, beside: int) -> int:
        """Return the width of the column of names before words, in a line with so many columns beside both."""


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

    def text(self, screen: Screen) -> "Iterator[SafeText]":
        """Yield the answer as people read it."""
        raise NotImplementedError

    def table(self) -> "Table":
        """Return the rows, of an answer that has them."""
        raise NotImplementedError

    def rows_alone(self) -> "Table":
        """Return the rows as CSV has them."""
        return self.table()

    def beside_rows(self) -> list[str]:
        """Return the lines that are told on stderr where only rows can be shown."""
        return []


class Drawable(Answer):
    """An answer that can be drawn."""

    __slots__ = ()

    def draw(self, file: "Place", kind: Any = None) -> None:
        """Draw it; `kind` is the format, where the suffix does not decide it."""
        raise NotImplementedError


class Drawn(Answer):
    """An answer, and the files that show it, too."""

    __slots__ = ("answer", "files", "provenance")

    def __init__(self, answer: Answer, *files: Path) -> None:
        self.answer, self.files = answer, files
        (self.provenance,) = provenances(answer)

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return what JSON says of the answer."""
        return self.answer.document(screen)

    def text(self, screen: Screen) -> "Iterator[SafeText]":
        """Yield the answer, and the names of the files."""
        yield from self.answer.text(screen)
        yield printable.lines(*map(str, self.files))


def drawn(ask: "Callable[[], Drawable]", **files: "Place | None") -> Answer:
    """Return the answer, and draw it to the files, given by the names of their options.

    Raises: UsageError, before anything is asked, if one lies inside a ledger; WriteFailed.
    """
    from fsar_ledger.ledger.store.paths import require_outside

    places = {kind: Path(file) for kind, file in files.items() if file is not None}
    for kind, file in places.items():
        require_outside(file, option(kind, file))
    found = ask()
    for kind, file in places.items():
        found.draw(file, kind)
    return Drawn(found, *places.values()) if places else found


class Lines(Answer):
    """An answer in a few lines, which JSON has by these names; `head` is that of a ledger that was written."""

    def __init__(self, *lines: str, **document: object) -> None:
        self._lines, self._document = lines, document

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return what JSON says."""
        return self._document

    def text(self, _: Screen) -> "Iterator[SafeText]":
        """Yield the lines."""
        yield printable.lines(*self._lines)


class Listing(Answer):
    """Rows about a run, with words for when there are none, and a hint of how to ask about the first.

    Args:
        run: The name of the run.
        found: The rows.
        time: The column of times, which people read with three digits.
        nothing: What there is none of, and `unseen`, what is added where not all that it rests on was observed.
        hint: Returns the hint for the first row.
        columns: Those that people are shown, by whether they are fitted to a terminal; None: all.
        document: What JSON says, but for the rows, which it has under `name`.
    """

    def __init__(
        self,
        run: str,
        found: "Table",
        *,
        time: str,
        nothing: tuple[str, str],
        hint: "Callable[[Screen, Row], str]",
        columns: Callable[[bool], Sequence[str] | None] = lambda _: None,
        name: str = "rows",
        **document: object,
    ) -> None:
        self._run, self._found, self._time, self._nothing, self._hint = run, found, time, nothing, hint
        self._columns, self._name, self._document = columns, name, document
        self.provenance = found.provenance

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the rows."""
        return {"run": self._run, **self._document, self._name: self._found.rows()}

    def text(self, screen: Screen) -> "Iterator[SafeText]":
        """Yield the rows, and the hint."""
        rows = self._found.rows()
        if not rows:
            unseen = f" on record; {self._nothing[1]}" if self.provenance.not_observed else ""
            yield printable.lines(screen.run_text(self._run), f"no {self._nothing[0]}{unseen}")
            return
        yield printable.lines(screen.run_text(self._run), "")
        times = [{**row, self._time: f"{row[self._time]:.3f}"} for row in rows]
        yield screen.table(times, self._columns(screen.is_fitted))
        yield printable.lines("", self._hint(screen, rows[0]))


class Plain(Answer):
    """An answer that is text as it is, such as a note or SQL."""

    def __init__(self, text: str) -> None:
        self._text = text

    def text(self, _: Screen) -> "Iterator[SafeText]":
        """Yield the text."""
        yield printable.SafeText(self._text)


def head_json(head: "HeadLike") -> dict[str, object]:
    """Return what JSON says of a head."""
    return {"size": head.size, "root": head.root}


class HeadLike(Protocol):
    """A tree head: the number of events and the root hash in hex."""

    @property
    def size(self) -> int: ...  # noqa: D102
    @property
    def root(self) -> str: ...  # noqa: D102


_STANDING = ("provenance", "provenances")


def provenances(answer: Any) -> "tuple[Provenance, ...]":
    """Return what an answer holds for, a provenance for each ledger; empty where it rests on none."""
    one = getattr(answer, "provenance", None)
    found: tuple[Provenance, ...] = getattr(answer, "provenances", () if one is None else (one,))
    return found
