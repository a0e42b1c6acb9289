"""Answers of any length as text, a few rows at a time, so that memory does not grow with the answer."""

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger import printable
from fsar_ledger.api.answers import head_json
from fsar_ledger.api.fields import Row, csv_text, json_bytes
from fsar_ledger.errors import UsageError
from fsar_ledger.printable import SafeText

from .tables import fitted, more_text
from .terminal import show, width_of_output

if TYPE_CHECKING:
    import pyarrow as pa

    from fsar_ledger.api.provenance import Provenance

    from .tables import Numbers

KEPT_BYTES = 16 << 20
"""Longer text waits in an unnamed file, not in memory, until it is complete."""
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
        if len(found := [option for option, is_asked in forms.items() if is_asked]) > 1:
            raise UsageError(f"found {' and '.join(found)}, expected one of them")
        if self.raw and not self.as_csv:
            raise UsageError(
                "found --raw without --csv, expected both or neither; --json always gives the values themselves"
            )

    @property
    def width(self) -> int | None:
        """Return the columns of the terminal that tables are fitted to; None if they are not."""
        return None if self.wide else width_of_output()

    def pieces(
        self,
        provenance: "Provenance",
        columns: Sequence[str],
        batches: "Iterable[pa.RecordBatch]",
        numbers: "Numbers" = dict,
    ) -> Iterator[SafeText]:
        """Yield the rows in this form, as text: in JSON with all their columns, else with these.

        A table on a terminal names runs by their numbers.

        Raises:
            QueryFailed: Python cannot hold a date or time.
        """
        if self.as_json:
            return _json(answer_json(provenance, {"rows": []}), batches)
        if self.as_ndjson:
            return _ndjson(batches)
        if self.as_csv:
            return _csv(columns, batches, raw=self.raw)
        return _table(columns, batches, self.limit, self.width, numbers)

    def show(self, pieces: Iterable[SafeText]) -> None:
        """Show the answer."""
        for piece in pieces:
            show(piece, raw=self.raw)


def answer_json(about: "Provenance | None", answer: Mapping[str, object]) -> SafeText:
    """Return one JSON object in ASCII: what the answer holds for, then the answer.

    Bytes of a file name that are not UTF-8 are escaped, `\\udcff` for ff.
    """
    if about is not None:
        verified = {} if about.rows_verified is None else {"rows_verified": about.rows_verified}
        answer = {"head": about.head and head_json(about.head), **verified, **about.answer(), **answer}
    text = msgspec.json.format(json_bytes(msgspec.to_builtins(answer)), indent=2).decode()
    return printable.ascii_json(f"{text}\n")


def _json(empty: str, batches: "Iterable[pa.RecordBatch]") -> Iterator[SafeText]:
    from fsar_ledger.api.texts import in_turn, json_lines

    before, after = empty.rsplit("[]", 1)
    is_first = True
    for lines in in_turn(partial(json_lines, before="    ", after=",\n"), filter(len, batches)):
        yield SafeText((before + "[\n" if is_first else ",\n") + lines.removesuffix(",\n"))
        is_first = False
    yield SafeText(f"{before}[]{after}" if is_first else f"\n  ]{after}")


def _ndjson(batches: "Iterable[pa.RecordBatch]") -> Iterator[SafeText]:
    from fsar_ledger.api.texts import in_turn, json_lines

    return map(SafeText, in_turn(json_lines, batches))


def _csv(columns: Sequence[str], batches: "Iterable[pa.RecordBatch]", *, raw: bool) -> Iterator[SafeText]:
    from fsar_ledger.api.texts import csv_lines, in_turn

    yield csv_text([], columns, raw=raw)
    yield from map(SafeText, in_turn(partial(csv_lines, raw=raw), (batch.select(list(columns)) for batch in batches)))


def _table(
    columns: Sequence[str],
    batches: "Iterable[pa.RecordBatch]",
    limit: int,
    width: int | None,
    numbers: "Numbers",
) -> Iterator[SafeText]:
    from fsar_ledger.api.table import rows_of

    shown: list[Row] = []
    count = 0
    constant = Constant(() if width is None else columns)
    for batch in batches:
        wanted = batch.slice(0, limit - len(shown)) if limit else batch
        shown += [row for rows in rows_of(wanted) for row in rows]
        count += len(batch)
        constant.see(batch)
    yield fitted(shown, columns, width, numbers, constant.names) or SafeText("(no rows)\n")
    if count > len(shown):
        yield more_text(count - len(shown))


class Constant:
    """The columns that have had one value in every row seen, shown or not."""

    def __init__(self, names: Iterable[str]):
        self.names = set(names)
        self._last: pa.RecordBatch | None = None

    def see(self, batch: "pa.RecordBatch") -> None:
        """Leave out the columns that differ in these rows, or from the rows before them."""
        if not len(batch):
            return
        before = batch if self._last is None else self._last
        self._last = batch.slice(len(batch) - 1)
        for name in sorted(self.names):
            column, one = batch[name], before[name].slice(len(before) - 1)
            is_one = column.slice(1).equals(column.slice(0, len(column) - 1))
            if not (is_one and column.slice(len(column) - 1).equals(one)):
                self.names.discard(name)


class Kept:
    """Text that is shown only once all of it is there, so that a reader gets a whole answer or an error."""

    def __init__(self, pieces: Iterable[SafeText]):
        """Make all pieces now. Raises: Whatever that raises."""
        self._file = tempfile.SpooledTemporaryFile(KEPT_BYTES)  # noqa: SIM115
        try:
            for piece in pieces:
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
