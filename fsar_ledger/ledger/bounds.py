"""What a segment may cost to read, found out before anything is unpacked.

A Parquet file of a few kilobytes can claim, and unpack to, any number of rows: one repeated value costs nothing to store.
So the headers of all its pages are read first, and a file that asks for more than any batch of
runs needs is refused.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.footer import Column, Page, read_footer, read_page

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


class Footer(NamedTuple):
    """What a segment is: its columns as they are stored, whether it declares an order of its rows, and all else as pyarrow holds it."""

    metadata: pq.FileMetaData
    columns: tuple[Column, ...]
    has_order: bool


def check_bounds(path: Path) -> Footer:
    """The footer of a segment that can be read within the bounds above.

    Raises:
        LedgerCorrupted: It asks for more, contradicts itself, or is no Parquet file.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        data, size = _read_footer(path, file)
        where = "the footer"
        try:
            columns, has_order = read_footer(data)
            metadata = pq.read_metadata(path)
            _check_footer(metadata, columns)
            unpacked = 0
            for number, column in enumerate(columns):
                where = f"column {column.path}"
                is_list = metadata.schema.column(number).max_repetition_level > 0
                unpacked = _check_column(file, size, column, MAX_LIST_VALUES if is_list else metadata.num_rows, unpacked)
        except IndexError as error:
            raise LedgerCorrupted(f"{path}: {where}: found half of it, expected all; restore the file") from error
        except ValueError as error:
            raise LedgerCorrupted(f"{path}: {where}: found {error}; restore the file") from error
    return Footer(metadata, columns, has_order)


def text_bytes(table: pa.Table) -> int:
    """The bytes of all strings of the table if each were written out where it stands, whether or not they are held as codes into dictionaries."""
    size = 0
    for column in table.columns:
        for chunk in column.chunks:
            if chunk.null_count == len(chunk):  # most columns of a short run
                continue
            values = chunk.flatten() if pa.types.is_list(chunk.type) else chunk
            if pa.types.is_dictionary(values.type):
                size += pc.sum(pc.binary_length(values.dictionary).cast(pa.int64()).take(values.indices)).as_py() or 0
            elif pa.types.is_string(values.type):
                size += pc.sum(pc.binary_length(values).cast(pa.int64())).as_py() or 0
    return size


def _read_footer(path: Path, file: BinaryIO) -> tuple[bytes, int]:
    """The bytes of the footer, and those of the file."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 8))
    end = file.read(8)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != _MAGIC or length > size - 12 or size > MAX_SEGMENT_BYTES:
        raise LedgerCorrupted(f"{path}: the segment cannot be read (found {size} bytes that end in {end[4:]!r}), expected a Parquet file; restore it")
    if length > _MAX_FOOTER_BYTES:
        raise LedgerCorrupted(f"{path}: found a footer of {length} bytes, expected at most {_MAX_FOOTER_BYTES}; restore the file")
    file.seek(size - 8 - length)
    return file.read(length), size


def _check_footer(metadata: pq.FileMetaData, columns: tuple[Column, ...]) -> None:
    """Raises: ValueError if pyarrow would read other columns, or too many rows."""
    if not 0 < metadata.num_rows <= MAX_ROWS:
        raise ValueError(f"{metadata.num_rows} rows, expected 1 to {MAX_ROWS}")
    found = [(column.path, column.type) for column in columns]
    expected = [(metadata.schema.column(number).path, metadata.schema.column(number).physical_type) for number in range(metadata.num_columns)]
    if found != expected:
        at = next((at for at, (one, other) in enumerate(zip(found, expected, strict=False)) if one != other), min(len(found), len(expected)))
        raise ValueError(f"column {at} as {found[at : at + 1]}, expected {expected[at : at + 1]} as in its schema")


def _check_column(file: BinaryIO, size: int, column: Column, most: int, unpacked: int) -> int:
    """The bytes unpacked so far and those of this column. Raises: ValueError or IndexError if its pages ask for too much or are not pages."""
    values = 0
    for number, page in enumerate(_pages(file, size, column)):
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


def _pages(file: BinaryIO, size: int, column: Column) -> Iterator[Page]:
    """The pages of a column. Raises: ValueError or IndexError where there is none."""
    at, end = column.at, column.at + column.stored_bytes
    if not 0 < at <= end <= size:
        raise ValueError(f"pages from byte {at} to {end}, expected them within the {size} bytes of the file")
    while at < end:
        file.seek(at)
        page, header = read_page(file.read(_MAX_HEADER_BYTES))
        yield page
        at += header + page.stored_bytes
        if at > end:
            raise ValueError(f"a page that ends at byte {at}, expected it to end by {end}")
