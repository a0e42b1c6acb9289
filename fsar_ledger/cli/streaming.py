"""Answers of any length as text, a few rows at a time, so that memory does not grow with the answer."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TextIO

import msgspec

from fsar_ledger.api.fields import Row, csv_text
from fsar_ledger.printable import Shown

from .output import answer_json, check_form, json_text, more_text
from .tables import table
from .terminal import show

if TYPE_CHECKING:
    from fsar_ledger.api.provenance import Provenance

KEPT_BYTES = 16 << 20
"""Longer text waits in an unnamed file, not in memory, until it is complete."""
PIECE = 1 << 20


class Form(msgspec.Struct, frozen=True, kw_only=True):
    """The form of an answer: JSON, CSV, or a table of at most `limit` rows (0: all), with `wide` with every column.

    Raises:
        UsageError: As `check_form`.
    """

    as_json: bool = False
    as_csv: bool = False
    raw: bool = False
    limit: int = 0
    wide: bool = False

    def __post_init__(self) -> None:
        check_form(as_json=self.as_json, as_csv=self.as_csv, raw=self.raw)

    def pieces(
        self, provenance: "Provenance", columns: Sequence[str], parts: Iterable[Sequence[Row]]
    ) -> Iterator[Shown]:
        """Yield the rows in this form, as text; each of the parts holds some rows."""
        if self.as_json:
            return _json(answer_json(provenance, {"rows": []}), parts)
        return _csv(columns, parts, raw=self.raw) if self.as_csv else _table(columns, parts, self.limit, wide=self.wide)

    def show(self, pieces: Iterable[Shown]) -> None:
        """Show the answer."""
        for piece in pieces:
            show(piece, raw=self.raw)


def _json(empty: str, parts: Iterable[Sequence[Row]]) -> Iterator[Shown]:
    before, after = empty.rsplit("[]", 1)
    bare = json_text(None, {"rows": []}).rsplit("[]", 1)
    is_first = True
    for rows in filter(len, parts):
        text = json_text(None, {"rows": rows})
        yield Shown((before + "[\n" if is_first else ",\n") + text[len(bare[0]) + 2 : -len(bare[1]) - 4])
        is_first = False
    yield Shown(f"{before}[]{after}" if is_first else f"\n  ]{after}")


def _csv(columns: Sequence[str], parts: Iterable[Sequence[Row]], *, raw: bool) -> Iterator[Shown]:
    header = csv_text([], columns, raw=raw)
    yield header
    for rows in parts:
        yield Shown(csv_text(rows, columns, raw=raw)[len(header) :])


def _table(columns: Sequence[str], parts: Iterable[Sequence[Row]], limit: int, *, wide: bool) -> Iterator[Shown]:
    shown: list[Row] = []
    count = 0
    for rows in parts:
        shown += rows[: limit - len(shown)] if limit else rows
        count += len(rows)
    yield table(shown, columns, wide=wide) or Shown("(no rows)\n")
    if count > len(shown):
        yield more_text(count - len(shown))


class Kept:
    """Text that is shown only once all of it is there, so that a reader gets a whole answer or an error."""

    def __init__(self, pieces: Iterable[Shown]):
        """Make all pieces now. Raises: Whatever that raises."""
        self._file: TextIO = tempfile.SpooledTemporaryFile(  # type: ignore[assignment]  # noqa: SIM115
            KEPT_BYTES, "w+", encoding="utf-8", errors="surrogatepass", newline=""
        )
        try:
            for piece in pieces:
                self._file.write(piece)
        except BaseException:
            self._file.close()
            raise

    def __iter__(self) -> Iterator[Shown]:
        """Yield the text, a few whole lines at a time; once."""
        with self._file as file:
            file.seek(0)
            yield from (Shown("".join(lines)) for lines in iter(lambda: file.readlines(PIECE), []))
