"""Check that a segment on disk has the one form that every reader interprets alike.

This reads only the footer and the page headers, before anything is unpacked. The column chunks fill the file from byte
4 to the footer, in the order of the schema, and pages fill their chunk: a dictionary first (strings only), then data.
Every count and size that is stored twice is the same in both places. `grammar` defines how each struct is written.
"""

import os
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import pyarrow as pa

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import bounds
from fsar_ledger.ledger.rows.grammar import (
    BOUNDS_END,
    DECODED,
    DICTIONARY_PAGE,
    GROUP_END,
    INTEGER_BOUNDS,
    LEAST,
    MAGIC,
    MOST,
    ROWS,
    RUN_ID_REST,
    UNBOUNDED,
    Column,
    Footer,
    encoding_statistics,
    unsigned,
)
from fsar_ledger.ledger.rows.schema import SCHEMAS

_AS_WRITTEN = "those of a segment as it is written"
_OTHER_FOOTER = f"the footer: other fields or values, expected {_AS_WRITTEN}"
MIN_ENTRY_BYTES = 4
"""The size in bytes of a string's length field in a dictionary."""


class PageInfo(NamedTuple):
    """The statistics of a column or a page, as stored in Parquet.

    `rows` are the rows of the page; None for a column.
    """

    name: str
    least: bytes
    most: bytes
    rows: tuple[int, int] | None = None


class Layout(NamedTuple):
    """The layout that a segment claims to have: rows, columns and writer, statistics and sizes.

    Statistics are those of columns and of pages; sizes are those of each column, as stored in Parquet.
    """

    rows: int
    schema: pa.Schema
    created_by: str
    statistics: tuple[PageInfo, ...]
    of_pages: tuple[PageInfo, ...]
    sizes: tuple[bytes, ...]


class _Chunk(NamedTuple):
    """The numbers of a column chunk: counts of bytes or values, offsets (`_at`), and statistics as stored."""

    column: Column
    values: int
    unpacked: int
    stored: int
    data_at: int
    dictionary_at: int
    encodings: bytes
    sizes: bytes


@cache
def _footers() -> tuple[Footer, ...]:
    """Return one footer for each set of columns that a release has."""
    footers: list[Footer] = []
    for schema in SCHEMAS.values():
        footers += [] if any(schema.equals(other.schema) for other in footers) else [Footer(schema)]
    return tuple(footers)


def read_file(path: Path) -> bytes:
    """Read a segment into memory once, so that the same bytes are hashed, checked and decoded.

    Raises:
        LedgerCorrupted: It exceeds the size limit of a segment.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(min(os.fstat(file.fileno()).st_size, bounds.MAX_SEGMENT_BYTES) + 1)
    if len(data) > bounds.MAX_SEGMENT_BYTES:
        raise LedgerCorrupted(
            f"{path}: found more than {bounds.MAX_SEGMENT_BYTES} bytes, expected a segment; restore the file"
        )
    return data


def check_layout(path: Path, data: bytes) -> Layout:
    """Check the segment with these bytes and return its layout. Errors name the path.

    Raises:
        LedgerCorrupted: It does not have the form of a segment, contradicts itself, or exceeds the `bounds`.
    """
    try:
        return read_layout(data)
    except ValueError as error:
        raise LedgerCorrupted(f"{path}: the segment cannot be read: found {error}; restore the file") from error


def read_layout(data: bytes) -> Layout:
    """Return the layout of the segment with these bytes.

    Raises:
        ValueError: It does not have the form of a segment, contradicts itself, or exceeds the `bounds`.
    """
    size, footer_at = len(data), _footer_at(data)
    expected = next((footer for footer in _footers() if data.startswith(footer.begin, footer_at)), None)
    if expected is None or (row_count := ROWS.match(data, offset := footer_at + len(expected.begin))) is None:
        raise ValueError(_OTHER_FOOTER)
    rows = DECODED[row_count[0]]
    if not 0 < rows <= bounds.MAX_ROWS:
        raise ValueError(f"{rows} rows, expected 1 to {bounds.MAX_ROWS}")
    offset = row_count.end()
    if not data.startswith(expected.group, offset):
        raise ValueError(_OTHER_FOOTER)
    offset += len(expected.group)
    page_at, unpacked, elements = len(MAGIC), 0, 0
    statistics, of_pages, sizes = list[PageInfo](), list[PageInfo](), list[bytes]()
    for column in expected.columns:
        result = _chunk(data, column, offset)
        if result is None:
            raise ValueError(f"the footer: column {column.name} in other fields or encodings, expected {_AS_WRITTEN}")
        chunk, chunk_statistics, offset = result
        statistics += [chunk_statistics] if chunk_statistics else []
        sizes.append(chunk.sizes)
        _check_chunk(chunk, rows, page_at)
        unpacked += chunk.unpacked
        elements += chunk.values - rows
        if elements > bounds.MAX_LIST_VALUES:
            raise ValueError(
                f"column {column.name}: {elements} elements of lists with those before, expected at most "
                f"{bounds.MAX_LIST_VALUES}"
            )
        if unpacked > bounds.MAX_UNPACKED_BYTES:
            raise ValueError(
                f"column {column.name}: pages that unpack to {unpacked} bytes with those before, expected at most "
                f"{bounds.MAX_UNPACKED_BYTES}"
            )
        page_at = _check_pages(data, chunk, page_at, of_pages)
    end = GROUP_END.match(data, offset)
    if (
        end is None
        or not data.startswith(expected.orders, end.end())
        or end.end() + len(expected.orders) != size - 8
        or end[4][0] != len(end[5])
    ):
        raise ValueError(_OTHER_FOOTER)
    said_twice = {
        "bytes unpacked": (end[1], unpacked),
        "rows": (end[2], rows),
        "bytes stored": (end[3], page_at - len(MAGIC)),
    }
    for what, (claimed, other) in said_twice.items():
        if DECODED[claimed] != other:
            raise ValueError(f"a row group of {DECODED[claimed]} {what}, expected {other}")
    if page_at != footer_at:
        raise ValueError(f"{footer_at - page_at} bytes between the last page and the footer, expected none")
    return Layout(rows, expected.schema, end[5].decode(), tuple(statistics), tuple(of_pages), tuple(sizes))


def _footer_at(data: bytes) -> int:
    """Return the offset of the footer. Raises: ValueError if there is none."""
    size, length = len(data), int.from_bytes(data[-8:-4], "little")
    if data[-4:] != MAGIC or length > size - 12:
        raise ValueError(f"{size} bytes that end in {data[-4:]!r}, expected a Parquet file")
    if data[:4] != MAGIC:
        raise ValueError(f"{size} bytes that begin with {data[:4]!r}, expected a Parquet file")
    if length > bounds.MAX_FOOTER_BYTES:
        raise ValueError(f"a footer of {length} bytes, expected at most {bounds.MAX_FOOTER_BYTES}")
    return size - 8 - length


def _chunk(data: bytes, column: Column, offset: int) -> tuple[_Chunk, PageInfo | None, int] | None:
    """Read the chunk of a column in the footer; return it, its statistics and its end; None if it does not match.

    Raises: ValueError if the statistics are invalid.
    """
    match = column.chunk.match(data, offset + len(column.about)) if data.startswith(column.about, offset) else None
    if match is None:
        return None
    chunk_statistics: PageInfo | None = None
    rest: re.Match[bytes] | None = match
    if column.name == "run_id":
        chunk_statistics, rest_offset = _text_bounds(data, match.end(), b"\x19")
        rest = RUN_ID_REST.match(data, rest_offset)
    if rest is None:
        return None
    values, unpacked, stored, data_at, dictionary_at, *stated = match.groups()
    if rest is match and stated[0]:
        chunk_statistics = _integer_bounds(column.name, stated[0])
    encodings, sizes = rest.groups()[-2:]
    return (
        _Chunk(
            column,
            DECODED[values],
            DECODED[unpacked],
            DECODED[stored],
            DECODED[data_at],
            DECODED[dictionary_at],
            encodings,
            sizes,
        ),
        chunk_statistics,
        rest.end(),
    )


def _text_bounds(data: bytes, offset: int, after: bytes) -> tuple[PageInfo | None, int]:
    """Read the statistics of `run_id`, if any, and the bytes `after` them; return the statistics and the end of both.

    Raises: ValueError if they are invalid.
    """
    if data[offset : offset + 1] == b"\x29":
        return None, offset + 1
    if data.startswith(unbounded := UNBOUNDED + after, offset):
        return None, offset + len(unbounded)
    if (most := MOST.match(data, offset)) and (
        least := LEAST.match(data, most.end() + (most_bytes := _length(most[1])))
    ):
        end = BOUNDS_END.match(data, least.end() + (least_bytes := _length(least[1])))
        if (
            end is not None
            and data.startswith(after, end.end())
            and max(most_bytes, least_bytes) <= bounds.MAX_BOUND_BYTES
        ):
            text_statistics = PageInfo(
                "run_id", data[least.end() : least.end() + least_bytes], data[most.end() : most.end() + most_bytes]
            )
            return text_statistics, end.end() + len(after)
    raise ValueError("other statistics of column run_id, expected most, least and no NULL")


def _page_bounds(data: bytes, name: str, header: re.Match[bytes]) -> tuple[PageInfo | None, int]:
    """Read the statistics of the page with this header; return them and the offset of its body.

    Raises: ValueError if they are invalid.
    """
    if header[6] is None:
        return _text_bounds(data, header.end() - 1, b"\x00\x00")
    return _integer_bounds(name, header[7]) if header.lastindex == 7 else None, header.end()


def _length(data: bytes) -> int:
    """Decode a Thrift length."""
    return data[0] if len(data) == 1 else data[0] & 0x7F | data[1] << 7


def _integer_bounds(name: str, stated: bytes) -> PageInfo:
    """Read the statistics of an integer column. Raises: ValueError if they contradict themselves."""
    matched = INTEGER_BOUNDS.fullmatch(stated)
    assert matched is not None
    most, least, most_again, least_again = matched.groups()
    if (most, least) != (most_again, least_again):
        raise ValueError(
            f"statistics of column {name} that say {least!r} to {most!r} and {least_again!r} to {most_again!r}, "
            "expected them once"
        )
    return PageInfo(name, least, most)


def _check_chunk(chunk: _Chunk, rows: int, start: int) -> None:
    """Check that the chunk begins at offset `start` and has a value for each row. Raises: ValueError if not."""
    name, kind = chunk.column.name, chunk.column.kind
    if kind == "strings":
        if chunk.values < rows:
            raise ValueError(f"column {name}: {chunk.values} values, expected at least {rows}")
    elif chunk.values != rows:
        raise ValueError(f"column {name}: {chunk.values} values, expected {rows}")
    has_dictionary = kind in ("string", "strings")
    begin = chunk.dictionary_at if has_dictionary else chunk.data_at
    if begin != start:
        raise ValueError(f"column {name}: pages from byte {begin}, expected from byte {start}, where those before end")


def _check_pages(data: bytes, chunk: _Chunk, start: int, of_pages: list[PageInfo]) -> int:
    """Check the pages of this chunk, collect their statistics in `of_pages`, and return the offset of their end.

    Raises: ValueError if they do not agree with the chunk.
    """
    name, has_dictionary = chunk.column.name, chunk.column.kind in ("string", "strings")
    offset, end = start, start + chunk.stored
    values = plain = pages = unpacked = 0
    if has_dictionary:
        offset, unpacked = _check_dictionary(data, name, offset)
    if offset != chunk.data_at:
        raise ValueError(f"column {name}: data from byte {chunk.data_at}, expected from byte {offset}")
    match = chunk.column.page.match
    while offset < end:
        header = match(data, offset)
        if header is None:
            raise ValueError(
                f"column {name}: a page header of other fields or encodings at byte {offset}, expected {_AS_WRITTEN}"
            )
        pages += 1
        if pages > bounds.MAX_PAGES:
            raise ValueError(f"column {name}: more than {bounds.MAX_PAGES} pages, expected fewer")
        page_statistics, body = _page_bounds(data, name, header)
        of_pages += [page_statistics._replace(rows=(values, DECODED[header[4]]))] if page_statistics else []
        stored = DECODED[header[2]]
        _check_sum(data, name, body, stored, header[3])
        values += DECODED[header[4]]
        plain += header[5] == b"\x00"
        unpacked += DECODED[header[1]] + body - offset
        offset = body + stored
    if offset != end:
        raise ValueError(f"column {name}: a page that ends at byte {offset}, expected it to end by {end}")
    if values != chunk.values:
        raise ValueError(f"column {name}: pages of {values} values, expected {chunk.values}")
    if unpacked != chunk.unpacked:
        raise ValueError(
            f"column {name}: pages that unpack to {unpacked} bytes with their headers, expected {chunk.unpacked}"
        )
    if chunk.encodings != encoding_statistics(chunk.column.kind, pages - plain if has_dictionary else pages, plain):
        raise ValueError(f"column {name}: other encodings than those of its {pages} pages, expected those")
    return end


def _check_dictionary(data: bytes, name: str, offset: int) -> tuple[int, int]:
    """Return the end of the dictionary at this offset, and its unpacked bytes, including the header.

    Raises: ValueError if there is no dictionary.
    """
    header = DICTIONARY_PAGE.match(data, offset)
    if header is None:
        raise ValueError(
            f"column {name}: a page header of other fields or encodings at byte {offset}, expected {_AS_WRITTEN}"
        )
    unpacked, stored, values = DECODED[header[1]], DECODED[header[2]], DECODED[header[4]]
    if values * MIN_ENTRY_BYTES > unpacked:
        raise ValueError(
            f"column {name}: a dictionary of {values} values in {unpacked} bytes, expected at least {MIN_ENTRY_BYTES} "
            "bytes each"
        )
    _check_sum(data, name, header.end(), stored, header[3])
    return header.end() + stored, unpacked + header.end() - offset


def _check_sum(data: bytes, name: str, offset: int, stored: int, stated: bytes) -> None:
    """Compare the stored bytes of a page with the checksum in its header. Raises: ValueError if they differ."""
    value = unsigned(stated)
    if (checksum := crc32(data[offset : offset + stored])) != (value >> 1 ^ -(value & 1)) & 0xFFFFFFFF:
        raise ValueError(
            f"column {name}: a page at byte {offset} with the checksum {checksum}, expected that of its header"
        )
