"""Long answers as text, some rows at a time, so that what a command holds does not grow with its answer. Nothing here prints.

The pieces together are what `output.answer_text` makes of all rows.
"""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from typing import TextIO

from fsar_ledger.errors import UsageError

from .output import HeadLike, Row, csv_text, json_text, more_text, table_text

KEPT_BYTES = 16 << 20
"""Text up to this size stays in memory until it is complete; more waits in a file without a name."""
PIECE = 1 << 20


def answer_pieces(
    head: HeadLike | None,
    columns: Sequence[str],
    parts: Iterable[Sequence[Row]],
    *,
    rows_verified: bool | None,
    as_json: bool,
    as_csv: bool,
    limit: int = 0,
) -> Iterator[str]:
    """The rows, of which each part holds some, as a table for people, or as what --json or --csv asks for.

    Raises:
        UsageError: Both are asked for.
    """
    if as_json and as_csv:
        raise UsageError("found --json and --csv, expected one of them")
    if as_json:
        return _json(json_text(head, {"rows": []}, rows_verified), parts)
    return _csv(columns, parts) if as_csv else _table(columns, parts, limit)


def _json(empty: str, parts: Iterable[Sequence[Row]]) -> Iterator[str]:
    before, after = empty.rsplit("[]", 1)
    bare = json_text(None, {"rows": []}).rsplit("[]", 1)
    is_first = True
    for rows in filter(len, parts):
        text = json_text(None, {"rows": rows})
        yield (before + "[\n" if is_first else ",\n") + text[len(bare[0]) + 2 : -len(bare[1]) - 4]
        is_first = False
    yield f"{before}[]{after}" if is_first else f"\n  ]{after}"


def _csv(columns: Sequence[str], parts: Iterable[Sequence[Row]]) -> Iterator[str]:
    header = csv_text([], columns)
    yield header
    for rows in parts:
        yield csv_text(rows, columns)[len(header) :]


def _table(columns: Sequence[str], parts: Iterable[Sequence[Row]], limit: int) -> Iterator[str]:
    shown: list[Row] = []
    count = 0
    for rows in parts:
        shown += rows[: limit - len(shown)] if limit else rows
        count += len(rows)
    yield table_text(shown, columns) or "no rows\n"
    if count > len(shown):
        yield more_text(count - len(shown))


class Kept:
    """Text that is shown only when all of it is there: whoever reads an answer gets a whole one or an error."""

    def __init__(self, pieces: Iterable[str]):
        """The pieces are made now. Raises: whatever that raises."""
        self._file: TextIO = tempfile.SpooledTemporaryFile(KEPT_BYTES, "w+", encoding="utf-8", errors="surrogatepass", newline="")  # type: ignore[assignment]  # noqa: SIM115
        try:
            for piece in pieces:
                self._file.write(piece)
        except BaseException:
            self._file.close()
            raise

    def __iter__(self) -> Iterator[str]:
        """The text, a few whole lines at a time; once."""
        with self._file as file:
            file.seek(0)
            yield from map("".join, iter(lambda: file.readlines(PIECE), []))
