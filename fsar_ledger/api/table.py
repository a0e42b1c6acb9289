"""An answer as a table: Arrow, polars or plain rows, with its provenance."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from fsar_ledger import printable
from fsar_ledger.metrics.database import plain_rows
from fsar_ledger.metrics.sandbox import SENT_BYTES, slices

from .fields import as_python
from .provenance import Provenance

if TYPE_CHECKING:
    import polars as pl

    from fsar_ledger.printable import SafeText

    from .answers import Screen

Row = dict[str, Any]

NOTHING = Provenance()
SHOWN_ROWS = 20
"""Rows that a notebook shows."""
SETTING = ("family", "family_tests", "seed", "seeds", "kind", "source", "model_version", "constants")
"""Columns of metrics that people are shown only where they tell rows apart."""


class Table:
    """The rows of an answer, read-only. Iterating yields a dictionary for each row, with None for NULL.

    `provenance` says which head of the ledger they hold for, whether the rows that were read were compared with its
    root (`Ledger.verify` does that, and remembers it), which planned runs are missing, and what runs do not observe.
    """

    def __init__(
        self,
        rows: pa.Table,
        provenance: Provenance = NOTHING,
    ) -> None:
        self.stored = rows
        """The rows as DuckDB gave them."""
        self.provenance = provenance

    @property
    def columns(self) -> list[str]:
        """Return the names of the columns."""
        return list(self.stored.column_names)

    def arrow(self) -> pa.Table:
        """Return the rows as an Arrow table; sums of integers are int64 where they fit."""
        return _with_integers(self.stored)

    def polars(self) -> "pl.DataFrame":
        """Return the rows as a polars data frame."""
        import polars as pl

        frame = pl.from_arrow(self.arrow())
        assert isinstance(frame, pl.DataFrame)
        return frame

    def rows(self) -> list[Row]:
        """Return all rows as dictionaries. Raises: As `parts`."""
        return [row for part in self.parts() for row in part]

    def parts(self) -> Iterator[list[Row]]:
        """Yield the rows as dictionaries, some at a time.

        Raises:
            QueryFailed: Python cannot hold a date or time.
        """
        for batch in self.stored.to_batches():
            yield from rows_of(batch)

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows in Arrow, some megabytes at a time."""
        for batch in self.stored.to_batches():
            yield from slices(batch, SENT_BYTES)

    def columns_shown(self) -> list[str]:
        """Return the columns that people are shown."""
        return self.columns

    def below(self, screen: "Screen") -> "Iterator[SafeText]":  # noqa: ARG002 - other tables look at it
        """Yield the lines below the rows, for people."""
        yield from ()

    def __iter__(self) -> Iterator[Row]:
        return (row for part in self.parts() for row in part)

    def __len__(self) -> int:
        return int(self.stored.num_rows)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {printable.counted(len(self), 'row')} of {printable.some(self.columns)}>"

    def _repr_html_(self) -> str:
        """Return the first rows as HTML, for notebooks; text from a ledger is escaped."""
        shown = plain_rows(self.stored.slice(0, SHOWN_ROWS))
        header = "".join(f"<th>{_cell(name)}</th>" for name in self.columns)
        body = "".join(f"<tr>{''.join(f'<td>{_cell(row[name])}</td>' for name in self.columns)}</tr>" for row in shown)
        more = len(self) - len(shown)
        rest = f"<p>... {more:,} more rows</p>" if more else ""
        return f"<table><thead><tr>{header}</tr></thead><tbody>{body}</tbody></table>{rest}"


class MetricTable(Table):
    """Rows about metrics. People are shown a setting only where it tells rows apart."""

    def columns_shown(self) -> list[str]:
        """Return the columns that people are shown."""
        return telling(self.rows())

    def below(self, screen: "Screen") -> "Iterator[SafeText]":
        """Yield the lines below the rows, for people."""
        yield from unit_of_interventions(screen)


def telling(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """Return the columns, without those of a setting that is the same in every row."""
    return [name for name in (rows[0] if rows else ()) if name not in SETTING or len({row[name] for row in rows}) > 1]


def unit_of_interventions(screen: "Screen") -> "Iterator[SafeText]":
    """Yield, on a terminal, the line that keeps a share of runs from being read as a number of calls."""
    if screen.is_fitted:
        calls = f"`fsar-ledger query interventions {printable.word(screen.path)}` lists the calls"
        yield printable.lines("", f"human_intervention is the share of runs that called the fleet supervisor; {calls}")


def rows_of(batch: pa.RecordBatch) -> Iterator[list[Row]]:
    """Yield the rows as dictionaries, some at a time.

    Raises:
        QueryFailed: Python cannot hold a date or time.
    """
    for part in slices(batch):
        with as_python():
            rows = plain_rows(pa.Table.from_batches([part]))
        yield rows


def of_structs(rows: Sequence[msgspec.Struct], kind: type[msgspec.Struct]) -> pa.Table:
    """Return typed rows as an Arrow table, with the columns of their type even if there are no rows."""
    fields = [(field.name, _arrow_type(field.type)) for field in msgspec.inspect.type_info(kind).fields]  # type: ignore[attr-defined]
    columns = [pa.array([getattr(row, name) for row in rows], type) for name, type in fields]
    return pa.Table.from_arrays(columns, names=[name for name, _ in fields])


def _arrow_type(kind: msgspec.inspect.Type) -> pa.DataType | None:
    """Return the Arrow type of a field; None where Arrow infers it from the values."""
    options = kind.types if isinstance(kind, msgspec.inspect.UnionType) else (kind,)
    named: dict[type, pa.DataType] = {
        msgspec.inspect.StrType: pa.string(),
        msgspec.inspect.IntType: pa.int64(),
        msgspec.inspect.FloatType: pa.float64(),
        msgspec.inspect.BoolType: pa.bool_(),
    }
    found = [named.get(type(one)) for one in options if not isinstance(one, msgspec.inspect.NoneType)]
    return found[0] if len(found) == 1 else None


def _with_integers(table: pa.Table) -> pa.Table:
    for at, field in enumerate(table.schema):
        if pa.types.is_decimal(field.type) and field.type.scale == 0:
            try:
                table = table.set_column(at, field.name, table.column(at).cast(pa.int64()))
            except pa.ArrowInvalid:  # too large for 64 bits: it stays a decimal
                continue
    return table


def _cell(value: object) -> str:
    if value is None:
        return "-"
    text = printable.number(value) if isinstance(value, float) else str(value)
    return html.escape(printable.cell(text))
