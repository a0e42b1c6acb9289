"""The hashed bytes of a stored row: its RFC 8785 JSON, with keys sorted and NULL columns omitted.

Two independent functions make them: `lines` from structs when events are appended, `from_table` from columns when a
ledger is verified, in C if that was built (`_write_rows.c`). Tests require them to agree.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice, repeat
from typing import Any, TypeAlias

import msgspec
import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.log import hashing
from fsar_ledger.ledger.log.hashing import leaves_of
from fsar_ledger.ledger.rows.bounds import has_more_text_than, text_bytes
from fsar_ledger.ledger.rows.compiled import codec
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, SCHEMA, STORED, StoredType

from . import Columns, as_columns, as_one_array, coded, numbers, places, validity

_ENCODER = msgspec.json.Encoder()
_SORTING_ENCODER = msgspec.json.Encoder(order="sorted")
# Limits of a segment at once. A commit of 25 runs has some ten thousand rows and 10 MB of text.
_MOST_ROWS, _MOST_TEXT = 1 << 16, 1 << 26
_ROWS_AT_ONCE = 256
_PIVOT = "run_id"  # never NULL, so the commas are placed around it


_BOOLEANS = (b"false\ntrue\n", np.array([5, 10]))

Rows: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int64]]"


def document(value: object) -> bytes:
    """Return the RFC 8785 JSON of strings, integers, booleans, None, lists and structs with ASCII names."""
    return _SORTING_ENCODER.encode(value)


def documents(values: Sequence[object]) -> bytes:
    """Return the RFC 8785 JSON of each value, as `document`, followed by a line feed."""
    return _SORTING_ENCODER.encode_lines(values)


def _row_type(layout: StoredType) -> tuple[type[msgspec.Struct], tuple[str, ...]]:
    """Return a struct of all columns of this event type in sorted order; its JSON omits those that are None."""
    names = tuple(sorted([field.name for field in (*ENVELOPE, *layout.fields)]))
    row = msgspec.defstruct(
        layout.cls.__name__ + "Row", [(name, Any, None) for name in names], omit_defaults=True, gc=False
    )
    return row, names


_ROW_TYPES = {tag: _row_type(layout) for tag, layout in STORED.items()}


def lines(tag: str, columns: Mapping[str, Sequence[object]]) -> Iterator[bytes]:
    """Yield the canonical bytes of rows of one event type, each followed by a line feed.

    They come a few hundred rows at a time, which stay in the CPU caches while they are hashed.

    Args:
        tag: The stored type of the events.
        columns: Every column of this type, envelope included, as Python values.
    """
    row, names = _ROW_TYPES[tag]
    rows = map(row, *[columns[name] for name in names])
    while encoded := _ENCODER.encode_lines(islice(rows, _ROWS_AT_ONCE)):
        yield encoded


class _Members:
    """One column as members of JSON objects, `"name":value` with a comma; empty where it is NULL.

    Members before `run_id`, which is never NULL, end with a comma; those after it begin with one.
    """

    def __init__(self, name: str, column: pa.Array) -> None:
        self._before = f'"{name}":'.encode() if name <= _PIVOT else f',"{name}":'.encode()
        self._after = b"," if name < _PIVOT else b""
        self._column, self._kind = column, COLUMNS[name]
        self.is_valid = validity(column)
        if self._kind == "string":  # strings repeat, so each is written once
            texts = coded(column)
            self._texts = self._members([*map(_ENCODER.encode, texts.dictionary.to_pylist())])
            self._places = places(texts)
        elif self._kind == "boolean":
            self._texts = self._members([b"false", b"true"])
            self._places = column.cast(pa.int8()).fill_null(2).to_numpy()
        elif self._kind == "integer":
            self._numbers = np.where(self.is_valid, numbers(column), 0)
            least, most = int(self._numbers.min()), int(self._numbers.max())
            if most - least < len(column):  # integers in a small range repeat too
                self._kind = "string"
                self._texts = self._members([b"%d" % number for number in range(least, most + 1)])
                self._places = np.where(self.is_valid, self._numbers - least, most - least + 1)

    def _members(self, values: Sequence[bytes]) -> "np.ndarray[tuple[int], np.dtype[np.object_]]":
        """Return the member for each value, followed by the empty one for NULL."""
        texts = np.empty(len(values) + 1, object)
        texts[:] = [*(self._before + value + self._after for value in values), b""]
        return texts

    def of(self, rows: Rows) -> list[bytes]:
        """Return the members of these rows."""
        match self._kind:
            case "string" | "boolean":
                texts: list[bytes] = self._texts[self._places[rows]].tolist()
                return texts
            case "integer":
                pattern = self._before + b"%d" + self._after
                members = [pattern % number for number in self._numbers[rows].tolist()]
            case "strings":
                values = self._column.take(pa.array(rows)).to_pylist()
                members = [self._before + _ENCODER.encode(value) + self._after for value in values]
        is_valid = self.is_valid[rows]
        return (
            members
            if is_valid.all()
            else [member if valid else b"" for member, valid in zip(members, is_valid.tolist(), strict=True)]
        )


def from_table(table: pa.Table) -> list[bytes]:
    """Return the canonical bytes of every row.

    Rows are processed by type, because a type has a tenth of the columns. String columns may be dictionaries.
    """
    columns = {name: as_one_array(table.column(name)) for name in sorted(table.column_names)}
    members = [_Members(name, column) for name, column in columns.items() if column.null_count < len(column)]
    codes = places(coded(columns["type"]))
    order = np.argsort(codes, kind="stable")
    starts = np.flatnonzero(np.diff(codes[order], prepend=-1))
    # By column, whether rows of each type have it.
    is_present = [np.logical_or.reduceat(column.is_valid[order], starts).tolist() for column in members]
    by_row = np.empty(len(table), object)
    for type_, rows in enumerate(np.split(order, starts[1:])):
        parts = [column.of(rows) for column, has_column in zip(members, is_present, strict=True) if has_column[type_]]
        by_row[rows] = list(map(b"".join, zip(repeat(b"{", len(rows)), *parts, repeat(b"}", len(rows)), strict=True)))
    lines: list[bytes] = by_row.tolist()
    return lines


def leaves(rows: pa.Table | Columns) -> bytes:
    """Return the packed RFC 6962 leaf hashes of the rows of a table, given as such or as its columns.

    Rows are encoded in parts, which saves memory.
    """
    columns = as_columns(rows)
    table = columns.table
    if len(table) <= _MOST_ROWS and not has_more_text_than(table, _MOST_TEXT):
        return _leaves(columns)
    most = max(1, min(_MOST_ROWS, _MOST_TEXT * len(table) // (text_bytes(table) + 1)))
    # A slice of a dictionary column would keep its whole dictionary.
    plain = pa.schema([SCHEMA.field(name) for name in table.column_names])
    return b"".join(_leaves(Columns(table.slice(start, most).cast(plain))) for start in range(0, len(table), most))


def _leaves(columns: Columns) -> bytes:
    lines = compiled_lines(columns)
    return leaves_of(from_table(columns.table)) if lines is None else hashing.leaves(lines)


def compiled_lines(columns: Columns) -> bytes | None:
    """Return the canonical bytes of the rows, each followed by a line feed; None if the C code was not built.

    String columns may be dictionaries.
    """
    if codec is None:
        return None
    rows = len(columns.table)
    names = [name for name in sorted(columns.table.column_names) if columns.arrays[name].null_count < rows]
    return codec.write_rows(rows, [_writer_arguments(name, columns) for name in names])


def _writer_arguments(name: str, columns: Columns) -> tuple[Any, ...]:
    """Decompose a column into the arguments that `write_rows` expects."""
    prefix, is_valid, column, kind = f'"{name}":'.encode(), columns.valid[name], columns.arrays[name], COLUMNS[name]
    if kind == "integer":
        return prefix, is_valid, numbers(column), None, None, None
    if kind == "boolean":
        return prefix, is_valid, numbers(column.cast(pa.int32())), *_BOOLEANS, None
    if kind == "string":
        return prefix, is_valid, columns.places[name], *_encoded(columns.texts[name]), None
    sizes: Rows = column.value_lengths().fill_null(0).to_numpy().astype(np.int64)
    starts = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
    return prefix, is_valid, columns.places[name], *_encoded(columns.texts[name]), starts


def _encoded(texts: list[str]) -> tuple[bytes, Rows]:
    """Return these texts as JSON, each followed by a line feed, and the offsets of the line feeds."""
    encoded = _ENCODER.encode_lines(texts)
    return encoded, np.flatnonzero(np.frombuffer(encoded, np.uint8) == ord("\n"))
