"""Long answers as text, some rows at a time, so that memory does not grow with the answer.

The pieces together are what `output.answer_text` makes of all rows.
"""

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, TextIO

from fsar_ledger.api.fields import Row, csv_text
from fsar_ledger.printable import Shown

from .output import HeadLike, check_form, json_text, more_text, table_text
from .terminal import show

if TYPE_CHECKING:
    from fsar_ledger.api.provenance import Provenance

KEPT_BYTES = 16 << 20
"""Text up to this size stays in memory until it is complete; more waits in a file without a name."""
PIECE = 1 << 20


class Form(NamedTuple):
    """The form in which an answer is asked for: a table of so many rows (0: all), JSON or CSV."""

    as_json: bool
    as_csv: bool
    raw: bool
    limit: int

    def check(self) -> None:
        """Check the form. Raises: UsageError as `check_form`."""
        check_form(as_json=self.as_json, as_csv=self.as_csv, raw=self.raw)

    def pieces(
        self, provenance: "Provenance", columns: Sequence[str], parts: Iterable[Sequence[Row]]
    ) -> Iterator[Shown]:
        """Return the answer as `answer_pieces` makes it."""
        return answer_pieces(
            provenance.head,
            columns,
            parts,
            rows_verified=provenance.rows_verified,
            as_json=self.as_json,
            as_csv=self.as_csv,
            raw=self.raw,
            limit=self.limit,
            more=provenance.answer(),
        )

    def show(self, pieces: Iterable[Shown]) -> None:
        """Show the answer."""
        for piece in pieces:
            show(piece, raw=self.raw)


def answer_pieces(
    head: HeadLike | None,
    columns: Sequence[str],
    parts: Iterable[Sequence[Row]],
    *,
    rows_verified: bool | None,
    as_json: bool,
    as_csv: bool,
    raw: bool = False,
    limit: int = 0,
    more: Mapping[str, object] = {},
) -> Iterator[Shown]:
    """Yield the rows as a table for people, or as --json or --csv asks for; in JSON with `more` before them.

    Each of the parts holds some rows.

    Raises:
        UsageError: As `check_form`.
    """
    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    if as_json:
        return _json(json_text(head, {**more, "rows": []}, rows_verified), parts)
    return _csv(columns, parts, raw=raw) if as_csv else _table(columns, parts, limit)


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


def _table(columns: Sequence[str], parts: Iterable[Sequence[Row]], limit: int) -> Iterator[Shown]:
    shown: list[Row] = []
    count = 0
    for rows in parts:
        shown += rows[: limit - len(shown)] if limit else rows
        count += len(rows)
    yield table_text(shown, columns) or Shown("(no rows)\n")
    if count > len(shown):
        yield more_text(count - len(shown))


class Kept:
    """Text that is shown only when all of it is there: whoever reads an answer gets a whole one or an error."""

    def __init__(self, pieces: Iterable[Shown]):
        """Make the pieces now. Raises: Whatever that raises."""
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
