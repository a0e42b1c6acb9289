"""What a segment may cost to read, found out before anything is unpacked.

A Parquet file of a few kilobytes can claim, and unpack to, any number of rows: one repeated value costs nothing to store.
So the headers of all its pages are read first (Thrift compact protocol), and a file that asks for more than any batch of
runs needs is refused.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.errors import LedgerCorrupted

MAX_ROWS = 1 << 20
"""Events in one commit; a batch of 25 runs has some ten thousand."""
MAX_SEGMENT_BYTES = 1 << 28
"""One event takes 17 bytes; so many rows of 256 bytes still fit."""
MAX_UNPACKED_BYTES = 1 << 29
"""All pages of a segment, unpacked."""
MAX_TEXT_BYTES = 1 << 29
"""All strings of a segment, each written out where it stands; its canonical rows are a little more."""
MAX_LIST_VALUES = 1 << 23
"""Elements of one column of lists: 8 for each of the most rows."""

_MAX_FOOTER_BYTES = 1 << 20
_MAX_HEADER_BYTES = 1 << 12
_MAX_PAGES = 1 << 10  # of one column: pyarrow begins a new page after 20,000 rows or 1 MiB
_MIN_ENTRY_BYTES = 4  # the length of a string, as a dictionary page holds it
_ENCODINGS = {  # those whose values take the space that they say; front-coded strings (DELTA_BYTE_ARRAY) do not
    0: "PLAIN",
    2: "PLAIN_DICTIONARY",
    3: "RLE",
    5: "DELTA_BINARY_PACKED",
    6: "DELTA_LENGTH_BYTE_ARRAY",
    8: "RLE_DICTIONARY",
    9: "BYTE_STREAM_SPLIT",
}
_MAGIC = b"PAR1"

_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_DATA, _INDEX, _DICTIONARY, _DATA_V2 = range(4)

_Struct = dict[int, "int | bytes | _Struct"]


class _Page(msgspec.Struct, frozen=True):
    """What the header of a page says. Units: bytes."""

    values: int
    encoding: int
    unpacked_bytes: int
    is_data: bool


def check_bounds(path: Path) -> pq.FileMetaData:
    """The footer of a segment that can be read within the bounds above.

    Raises:
        LedgerCorrupted: It asks for more, or is no Parquet file.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        _check_footer(path, file)
        metadata = pq.read_metadata(path)
        if metadata.num_row_groups != 1:
            raise LedgerCorrupted(f"{path}: found {metadata.num_row_groups} row groups, expected 1; restore the file")
        if not 0 < metadata.num_rows <= MAX_ROWS:
            raise LedgerCorrupted(f"{path}: found {metadata.num_rows} rows, expected 1 to {MAX_ROWS}; restore the file")
        unpacked = 0
        for number in range(metadata.num_columns):
            column = metadata.row_group(0).column(number)
            most = metadata.num_rows if metadata.schema.column(number).max_repetition_level == 0 else MAX_LIST_VALUES
            try:
                unpacked = _check_column(file, column, most, unpacked)
            except (ValueError, IndexError) as error:
                raise LedgerCorrupted(f"{path}: column {column.path_in_schema}: found {error or 'half a page header'}; restore the file") from error
    return metadata


def text_bytes(table: pa.Table) -> int:
    """The bytes of all strings of the table if each were written out where it stands, whether or not they are held as codes into dictionaries."""
    size = 0
    for column in table.columns:
        for chunk in column.chunks:
            values = chunk.flatten() if pa.types.is_list(chunk.type) else chunk
            if pa.types.is_dictionary(values.type):
                size += pc.sum(pc.binary_length(values.dictionary).take(values.indices).cast(pa.int64())).as_py() or 0
            elif pa.types.is_string(values.type):
                size += pc.sum(pc.binary_length(values).cast(pa.int64())).as_py() or 0
    return size


def _check_footer(path: Path, file: BinaryIO) -> None:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 8))
    end = file.read(8)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != _MAGIC or length > size - 12 or size > MAX_SEGMENT_BYTES:
        raise LedgerCorrupted(f"{path}: the segment cannot be read (found {size} bytes that end in {end[4:]!r}), expected a Parquet file; restore it")
    if length > _MAX_FOOTER_BYTES:
        raise LedgerCorrupted(f"{path}: found a footer of {length} bytes, expected at most {_MAX_FOOTER_BYTES}; restore the file")


def _check_column(file: BinaryIO, column: pq.ColumnChunkMetaData, most: int, unpacked: int) -> int:
    """The bytes unpacked so far and those of this column. Raises: ValueError or IndexError if its pages ask for too much or are not pages."""
    values = 0
    for number, page in enumerate(_pages(file, column)):
        unpacked += page.unpacked_bytes
        values += page.values if page.is_data else 0
        if number >= _MAX_PAGES:
            raise ValueError(f"more than {_MAX_PAGES} pages, expected fewer")
        if unpacked > MAX_UNPACKED_BYTES:
            raise ValueError(f"pages that unpack to {unpacked} bytes with those before, expected at most {MAX_UNPACKED_BYTES}")
        if values > most:
            raise ValueError(f"pages of {values} values, expected at most {most}")
        if not page.is_data and page.values * _MIN_ENTRY_BYTES > page.unpacked_bytes:
            raise ValueError(f"a dictionary of {page.values} values in {page.unpacked_bytes} bytes, expected at least {_MIN_ENTRY_BYTES} bytes each")
        if page.encoding not in _ENCODINGS:
            raise ValueError(f"a page in encoding {page.encoding}, expected one of {', '.join(_ENCODINGS.values())}")
    return unpacked


def _pages(file: BinaryIO, column: pq.ColumnChunkMetaData) -> Iterator[_Page]:
    """The pages of a column. Raises: ValueError or IndexError where there is none."""
    at = column.dictionary_page_offset or column.data_page_offset
    at = min(at, column.data_page_offset)
    end = at + column.total_compressed_size
    size = file.seek(0, os.SEEK_END)
    if not 0 < at <= end <= size:
        raise ValueError(f"pages from byte {at} to {end}, expected them within the {size} bytes of the file")
    while at < end:
        file.seek(at)
        page, length, header = _page(file.read(_MAX_HEADER_BYTES))
        yield page
        at += header + length
        if at > end:
            raise ValueError(f"a page that ends at byte {at}, expected it to end by {end}")


def _page(data: bytes) -> tuple[_Page, int, int]:
    """The page whose header these bytes begin with, its length as stored, and the length of its header."""
    header, length = _struct(data, 0, 0)
    kind, unpacked, stored = (_integer(header, field) for field in (1, 2, 3))
    fields = {_DATA: (5, 1, 2), _DICTIONARY: (7, 1, 2), _DATA_V2: (8, 1, 4)}.get(kind)
    if fields is None:
        raise ValueError(f"a page of kind {kind}, expected data or a dictionary")
    part = header.get(fields[0])
    if not isinstance(part, dict):
        raise ValueError("a page without the header of its kind")
    return _Page(_integer(part, fields[1]), _integer(part, fields[2]), unpacked, kind != _DICTIONARY), stored, length


def _integer(struct: _Struct, field: int) -> int:
    value = struct.get(field)
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r:.40} as field {field} of a page header, expected a count")
    return value


def _struct(data: bytes, at: int, depth: int) -> tuple[_Struct, int]:
    """The struct that begins here, and where it ends."""
    found: _Struct = {}
    field = 0
    while data[at]:
        kind, step = data[at] & 15, data[at] >> 4
        at += 1
        if step:
            field += step
        else:
            field, at = _zigzag(data, at)
        if kind in (_TRUE, _FALSE):
            found[field] = int(kind == _TRUE)
        elif kind in (_I16, _I32, _I64):
            found[field], at = _zigzag(data, at)
        elif kind == _BINARY:
            length, at = _varint(data, at)
            found[field] = data[at : at + length]
            at += length
        elif kind == _STRUCT and depth < 3:
            found[field], at = _struct(data, at, depth + 1)
        else:
            raise ValueError(f"a page header with a field of type {kind}, expected numbers, bytes and structs")
    return found, at + 1


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while data[at] & 0x80:
        value |= (data[at] & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if shift > 63:
            raise ValueError("a number of more than 64 bits in a page header")
    return value | data[at] << shift, at + 1


def _zigzag(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return value >> 1 ^ -(value & 1), at
