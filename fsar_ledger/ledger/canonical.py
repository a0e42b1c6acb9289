"""The bytes of one stored row that are hashed: RFC 8785 JSON of the row, keys sorted, NULL columns left out.

Two independent producers make them: `lines` from structs when events are appended, `from_table` from
columns when a ledger is verified. Tests hold them equal.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, Literal

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.ledger.schema import COLUMNS, ENVELOPE, LAYOUTS, Layout

_ENCODER = msgspec.json.Encoder()
_SORTING_ENCODER = msgspec.json.Encoder(order="sorted")
_TEXT = pa.large_string()
_ROWS_AT_ONCE = 256
_PIVOT = "run_id"  # a column that is never NULL, so the commas can lean on it


def document(value: object) -> bytes:
    """The RFC 8785 JSON of a document of strings, integers, booleans, None, lists and structs with ASCII names."""
    return _SORTING_ENCODER.encode(value)


def _row_type(layout: Layout) -> tuple[type[msgspec.Struct], tuple[str, ...]]:
    """A struct of all columns of this event type in sorted order, which JSON leaves out where they are None."""
    names = tuple(sorted([field.name for field in (*ENVELOPE, *layout.fields)]))
    row = msgspec.defstruct(layout.cls.__name__ + "Row", [(name, Any, None) for name in names], omit_defaults=True, gc=False)
    return row, names


_ROW_TYPES = {tag: _row_type(layout) for tag, layout in LAYOUTS.items()}


def lines(tag: str, columns: Mapping[str, Sequence[object]]) -> Iterator[list[bytes]]:
    """The canonical bytes of rows of one event type, each after the 0x00 that RFC 6962 puts before a leaf.

    They come in lists of a few hundred rows, which the processor's caches hold while they are hashed.

    Args:
        tag: The stored type of the events.
        columns: Every column of this type, envelope included, as Python values.
    """
    row, names = _ROW_TYPES[tag]
    rows = map(row, *[columns[name] for name in names])
    while encoded := _ENCODER.encode_lines(islice(rows, _ROWS_AT_ONCE)):
        yield (b"\x00" + encoded[:-1].replace(b"\n", b"\n\x00")).split(b"\n")  # JSON holds no raw line feed


def _joined(*pieces: pa.Array | str, nulls: Literal["emit_null", "skip"] = "emit_null") -> pa.Array:
    """The pieces of each row behind each other; where one of them is NULL, NULL or without it (`skip`)."""
    texts = [pa.scalar(piece, _TEXT) if isinstance(piece, str) else piece for piece in pieces]
    return pc.binary_join_element_wise(*texts, pa.scalar("", _TEXT), null_handling=nulls)


def _quoted(strings: pa.Array, before: str = "", after: str = "") -> pa.Array:
    """The JSON of these strings between two texts; NULL stays NULL. Strings repeat, so each is written once."""
    coded = strings.dictionary_encode()
    texts = [f"{before}{_ENCODER.encode(value).decode()}{after}" for value in coded.dictionary.to_pylist()]
    return pa.array(texts, _TEXT).take(coded.indices)


def _members(name: str, column: pa.Array, before: str, after: str) -> pa.Array:
    """The JSON of the values of a column between two texts; NULL stays NULL."""
    match COLUMNS[name]:
        case "string":
            return _quoted(column, before, after)
        case "integer":
            return _joined(before, column.cast(_TEXT), after)
        case "boolean":
            return pc.if_else(column, pa.scalar(f"{before}true{after}", _TEXT), pa.scalar(f"{before}false{after}", _TEXT))
        case "strings":
            lists = pa.LargeListArray.from_arrays(column.offsets.cast(pa.int64()), _quoted(column.values), mask=column.is_null())
            return _joined(f"{before}[", pc.binary_join(lists, pa.scalar(",", _TEXT)), f"]{after}")


def from_table(table: pa.Table) -> list[bytes]:
    """The canonical bytes of every row, each after the 0x00 that RFC 6962 puts before a leaf."""
    pieces: list[pa.Array | str] = ["\x00{"]
    for name in sorted(table.column_names):
        column = table.column(name).combine_chunks()
        if column.null_count == len(column) > 0:
            continue
        pieces.append(_members(name, column, f'"{name}":' if name <= _PIVOT else f',"{name}":', "," if name < _PIVOT else ""))
    found: list[bytes] = _joined(*pieces, "}", nulls="skip").cast(pa.large_binary()).to_pylist()
    return found


def hashes(rows: Sequence[bytes]) -> list[bytes]:
    """The RFC 6962 leaf hash of each row, given after its 0x00."""
    sha256 = hashlib.sha256
    return [sha256(row).digest() for row in rows]
