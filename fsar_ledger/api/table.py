"""An answer as a table: Arrow, polars or plain rows, with its provenance."""

import html
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText
from fsar_ledger.metrics.database import plain_rows
from fsar_ledger.metrics.provenance import Provenance
from fsar_ledger.metrics.sandbox import SENT_BYTES, slices

from .answers import Answer, Row, Screen
from .names import Place
from .tables import Constant, fitted, more_text
from .texts import as_python

if TYPE_CHECKING:
    import polars as pl

NOTHING = Provenance()
SHOWN_ROWS = 20
"""Rows that a notebook shows."""
SETTING = ("family", "family_tests", "seed", "seeds", "kind", "source", "model_version", "constants")
"""Columns of metrics that text shows only if they distinguish rows."""


class Rows(Answer):
    """Rows that are read once, some megabytes at a time, so that a long answer is never in memory whole."""

    def __init__(self, provenance: Provenance, columns: Sequence[str], batches: Iterable[pa.RecordBatch]) -> None:
        self.provenance = provenance
        self.columns = list(columns)
        """The names of the columns."""
        self._batches = batches
        self.name = "rows"
        """Their name in JSON."""

    def batches(self) -> Iterable[pa.RecordBatch]:
        """Return the rows in Arrow, some megabytes at a time."""
        return self._batches

    def rows_alone(self) -> "Rows":
        """Return the rows."""
        return self

    def columns_shown(self) -> list[str]:
        """Return the columns that are shown as text."""
        return self.columns

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the first rows as a table, on a terminal with runs by number, and how many more there are.

        Raises:
            QueryFailed: Python cannot hold a date or time.
        """
        shown: list[Row] = []
        count, columns = 0, self.columns_shown()
        constant = Constant(columns if screen.is_fitted else ())
        for batch in self.batches():
            part = batch.slice(0, screen.limit - len(shown)) if screen.limit else batch
            shown += [row for rows in rows_of(part) for row in rows]
            count += len(batch)
            constant.see(batch)
        yield fitted(shown, columns, screen.width, screen.numbers, constant.names) or SafeText("(no rows)\n")
        if count > len(shown):
            yield more_text(count - len(shown))


class Table(Rows):
    """The rows of an answer, read-only. Iterating yields a dictionary for each row, with None for NULL.

    `provenance` says which head of the ledger they hold for, whether the rows that were read were compared with its
    root (`Ledger.verify` does that, and remembers it), which planned runs are missing, and what runs do not observe.
    """

    def __init__(self, rows: pa.Table, provenance: Provenance = NOTHING, *, name: str = "rows") -> None:
        super().__init__(provenance, rows.column_names, ())
        self.name = name
        self.stored = rows
        """The rows as DuckDB gave them."""

    def table(self) -> "Table":
        """Return these rows, as every answer that has rows does."""
        return self

    def arrow(self) -> pa.Table:
        """Return the rows as an Arrow table; sums of integers are int64 where they fit."""
        return _with_integers(self.stored)

    def polars(self) -> "pl.DataFrame":
        """Return the rows as a polars data frame."""
        import polars as pl

        frame = pl.from_arrow(self.arrow())
        assert isinstance(frame, pl.DataFrame)
        return frame

    def rows(self) -> list[dict[str, Any]]:
        """Return all rows as dictionaries. Raises: As `parts`."""
        return [row for part in self.parts() for row in part]

    def parts(self) -> Iterator[list[dict[str, Any]]]:
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

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (row for part in self.parts() for row in part)

    def __len__(self) -> int:
        return int(self.stored.num_rows)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {printable.counted(len(self), 'row')} of {printable.list_few(self.columns)}>"

    def _repr_html_(self) -> str:
        """Return the first rows as HTML, for notebooks; text from a ledger is escaped."""
        shown = plain_rows(self.stored.slice(0, SHOWN_ROWS))
        header = "".join(f"<th>{_cell(name)}</th>" for name in self.columns)
        body = "".join(f"<tr>{''.join(f'<td>{_cell(row[name])}</td>' for name in self.columns)}</tr>" for row in shown)
        more = len(self) - len(shown)
        rest = f"<p>... {more:,} more rows</p>" if more else ""
        return f"<table><thead><tr>{header}</tr></thead><tbody>{body}</tbody></table>{rest}"


class MetricTable(Table):
    """Rows about metrics, shown as text with only those settings that distinguish rows.

    `left_out` counts the runs without a scenario, which are in no row if each row is of one scenario.
    """

    def __init__(self, rows: pa.Table, provenance: Provenance = NOTHING, *, left_out: int = 0) -> None:
        super().__init__(rows, provenance)
        self.left_out = left_out

    def beside_rows(self) -> list[str]:
        """Return a line on the runs that are in no row."""
        are = "is" if self.left_out == 1 else "are"
        return [f"{printable.counted(self.left_out, 'run')} without a scenario {are} in no row"] * (self.left_out > 0)

    def columns_shown(self) -> list[str]:
        """Return the columns that are shown as text."""
        return telling(self.rows())

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the rows, which runs are in none, and what one of the metrics counts."""
        yield from super().text(screen)
        yield printable.lines(*(("", *beside) if (beside := self.beside_rows()) else ()))
        yield from unit_of_interventions(screen)


class Listing(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """Rows about a run, with a text for when there are none, and a hint for the first row.

    Attributes:
        run: The name of the run.
        found: The rows.
        time: The column of times, shown with three decimals.
        nothing: What the rows are called if there are none.
        unseen: What is added to that if not everything that the rows rest on was observed.
        hint: Returns the hint for the first row.
        undrawn: Why it cannot be drawn.
        columns: The columns shown, by whether they are fitted to a terminal; None: all.
        name: The name of the rows in JSON.
        about: Other fields of the JSON document.
    """

    run: str
    found: Table
    time: str
    nothing: str
    unseen: str
    hint: Callable[[Screen, Row], str]
    undrawn: str
    columns: Callable[[bool], Sequence[str] | None] = lambda _: None
    name: str = "rows"
    about: Mapping[str, object] = {}

    @property
    def provenance(self) -> Provenance:
        """The provenance of the rows."""
        return self.found.provenance

    def draw(self, file: Place, kind: str | None = None) -> None:
        """Refuse. Raises: UsageError."""
        raise UsageError(f"--{kind} {file}: {self.undrawn}")

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the rows."""
        return {"run": self.run, **self.about, self.name: self.found.rows()}

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the rows, and the hint."""
        rows = self.found.rows()
        if not rows:
            unseen = f" on record; {self.unseen}" if self.provenance.not_observed else ""
            yield printable.lines(screen.run_text(self.run), f"no {self.nothing}{unseen}")
            return
        yield printable.lines(screen.run_text(self.run), "")
        times = [{**row, self.time: f"{row[self.time]:.3f}"} for row in rows]
        yield screen.table(times, self.columns(screen.is_fitted))
        yield printable.lines("", self.hint(screen, rows[0]))


def telling(rows: Sequence[Row]) -> list[str]:
    """Return the columns, without settings that are the same in every row."""
    return [name for name in (rows[0] if rows else ()) if name not in SETTING or len({row[name] for row in rows}) > 1]


def unit_of_interventions(screen: Screen) -> Iterator[SafeText]:
    """Yield, on a terminal, the line that keeps a share of runs from being read as a number of calls."""
    if screen.is_fitted:
        calls = f"`fsar-ledger query interventions {printable.word(screen.path)}` lists the calls"
        yield printable.lines("", f"human_intervention is the share of runs that called the fleet supervisor; {calls}")


def rows_of(batch: pa.RecordBatch) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows as dictionaries, some at a time.

    Raises:
        QueryFailed: Python cannot hold a date or time.
    """
    for part in slices(batch):
        with as_python():
            rows = plain_rows(pa.Table.from_batches([part]))
        yield rows


def plain(rows: Sequence[msgspec.Struct]) -> list[dict[str, Any]]:
    """Return typed rows as mappings."""
    return [msgspec.structs.asdict(row) for row in rows]


def of_structs(rows: Sequence[msgspec.Struct], kind: type[msgspec.Struct]) -> pa.Table:
    """Return typed rows as an Arrow table, with the columns of their type even if there are no rows."""
    fields = [(field.name, _arrow_type(field.type)) for field in msgspec.inspect.type_info(kind).fields]  # type: ignore[attr-defined]
    columns = [pa.array([getattr(row, name) for row in rows], type) for name, type in fields]
    return pa.Table.from_arrays(columns, names=[name for name, _ in fields])


def _arrow_type(kind: msgspec.inspect.Type) -> pa.DataType | None:
    """Return the Arrow type of a field; None where Arrow infers it from the values."""
    options = kind.types if isinstance(kind, msgspec.inspect.UnionType) else (kind,)
    types: dict[type, pa.DataType] = {
        msgspec.inspect.StrType: pa.string(),
        msgspec.inspect.IntType: pa.int64(),
        msgspec.inspect.FloatType: pa.float64(),
        msgspec.inspect.BoolType: pa.bool_(),
    }
    arrow_types = [types.get(type(option)) for option in options if not isinstance(option, msgspec.inspect.NoneType)]
    return arrow_types[0] if len(arrow_types) == 1 else None


def _with_integers(table: pa.Table) -> pa.Table:
    for index, field in enumerate(table.schema):
        if pa.types.is_decimal(field.type) and field.type.scale == 0:
            try:
                table = table.set_column(index, field.name, table.column(index).cast(pa.int64()))
            except pa.ArrowInvalid:  # too large for 64 bits: it stays a decimal
                continue
    return table


def _cell(value: object) -> str:
    if value is None:
        return "-"
    text = printable.number(value) if isinstance(value, float) else str(value)
    return html.escape(printable.cell(text))
