"""The check that a segment lies on the disk in the one form that every reader reads alike.

It takes the footer and the page headers, before anything is unpacked.

The chunks of the columns fill the file from byte 4 to the footer, in the order of the schema, and pages fill their
chunk: a dictionary first (strings only), then data. Every count and size that is said in two places is the same in
both. How each struct is written, `grammar` says.
"""

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import pyarrow as pa

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import bounds
from fsar_ledger.ledger.rows.footer import explain_footer, explain_page
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
from fsar_ledger.ledger.rows.releases import SCHEMAS

MIN_ENTRY_BYTES = 4
"""The length of a string, as a dictionary holds it."""
_MAX_DICTIONARY_BYTES = 1 << 22
"""pyarrow begins no new entry after 1 MiB."""


class Said(NamedTuple):
    """The statistics of a column, as Parquet holds them.

    `rows` are those of the page that they are about, None for those of the column.
    """

    name: str
    least: bytes
    most: bytes
    rows: tuple[int, int] | None = None


class Layout(NamedTuple):
    """The layout of a segment, as it says itself: rows, columns and writer, statistics and sizes.

    Statistics are those of columns and of pages; sizes are of each column, as Parquet holds them.
    """

    rows: int
    schema: pa.Schema
    created_by: str
    statistics: tuple[Said, ...]
    of_pages: tuple[Said, ...]
    sizes: tuple[bytes, ...]


class _Chunk(NamedTuple):
    """The numbers of a column chunk. `place` is where it begins; the others count bytes or values."""

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
    """Return the footers of all releases whose columns differ."""
    found: list[Footer] = []
    for schema in SCHEMAS.values():
        found += [] if any(schema.equals(other.schema) for other in found) else [Footer(schema)]
    return tuple(found)


def read_file(path: Path) -> bytes:
    """Read the bytes of a segment at once: what is hashed, checked and decoded should be the same.

    Raises:
        LedgerCorrupted: It is larger than any segment.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(bounds.MAX_SEGMENT_BYTES + 1)
    if len(data) > bounds.MAX_SEGMENT_BYTES:
        raise LedgerCorrupted(
            f"{path}: found more than {bounds.MAX_SEGMENT_BYTES} bytes, expected a segment; restore the file"
        )
    return data


def check_layout(path: Path, data: bytes) -> Layout:
    """Check the segment with these bytes and return its layout; the path is for messages only.

    Raises:
        LedgerCorrupted: It lies otherwise than a segment does, contradicts itself, or asks for more than `bounds`
            allow.
    """
    try:
        return read_layout(data)
    except ValueError as error:
        raise LedgerCorrupted(f"{path}: the segment cannot be read: found {error}; restore the file") from error


def read_layout(data: bytes) -> Layout:
    """Return the layout of the segment with these bytes.

    Raises:
        ValueError: It lies otherwise than a segment does, contradicts itself, or asks for more than `bounds` allow.
    """
    size, footer_at = len(data), _footer_at(data)
    known = next((footer for footer in _footers() if data.startswith(footer.begin, footer_at)), None)
    if known is None or (found := ROWS.match(data, at := footer_at + len(known.begin))) is None:
        raise ValueError(explain_footer(data[footer_at:-8], (known or _footers()[-1]).schema))
    rows = DECODED[found[0]]
    if not 0 < rows <= bounds.MAX_ROWS:
        raise ValueError(f"{rows} rows, expected 1 to {bounds.MAX_ROWS}")
    at = found.end()
    if not data.startswith(known.group, at):
        raise ValueError(explain_footer(data[footer_at:-8], (known or _footers()[-1]).schema))
    at += len(known.group)
    place, unpacked, elements, statistics, of_pages, sizes = len(MAGIC), 0, 0, list[Said](), list[Said](), list[bytes]()
    for column in known.columns:
        found_chunk = _chunk(data, column, at)
        if found_chunk is None:
            raise ValueError(explain_footer(data[footer_at:-8], known.schema))
        chunk, said, at = found_chunk
        statistics += [said] if said else []
        sizes.append(chunk.sizes)
        _check_chunk(chunk, rows, place)
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
        place = _check_pages(data, chunk, place, of_pages)
    end = GROUP_END.match(data, at)
    if (
        end is None
        or not data.startswith(known.orders, end.end())
        or end.end() + len(known.orders) != size - 8
        or end[4][0] != len(end[5])
    ):
        raise ValueError(explain_footer(data[footer_at:-8], (known or _footers()[-1]).schema))
    said_twice = {
        "bytes unpacked": (end[1], unpacked),
        "rows": (end[2], rows),
        "bytes stored": (end[3], place - len(MAGIC)),
    }
    for what, (one, other) in said_twice.items():
        if DECODED[one] != other:
            raise ValueError(f"a row group of {DECODED[one]} {what}, expected {other}")
    if place != footer_at:
        raise ValueError(f"{footer_at - place} bytes between the last page and the footer, expected none")
    return Layout(rows, known.schema, end[5].decode(), tuple(statistics), tuple(of_pages), tuple(sizes))


def dictionary_of_runs(data: bytes, rows: int) -> list[str] | None:
    """Return the strings in the dictionary of `run_id`: all runs of a segment of so many rows, perhaps more.

    A dictionary may hold more strings than are used.

    `run_id` is the first column, so the beginning of a segment will do. None if it was cut off too early, lies
    otherwise than a segment does, or has rows whose strings are in no dictionary.
    """
    header = DICTIONARY_PAGE.match(data, len(MAGIC))
    if header is None or DECODED[header[1]] > _MAX_DICTIONARY_BYTES:
        return None
    at, values = header.end() + DECODED[header[2]], 0
    try:
        _check_sum(data, "run_id", header.end(), DECODED[header[2]], header[3])
        while values < rows:
            page = _footers()[-1].columns[0].page.match(data, at)
            if page is None or page[5] == b"\x00":
                return None
            _, body = _page_bounds(data, "run_id", page)
            at, values = body + DECODED[page[2]], values + DECODED[page[4]]
        return _strings(
            pa.decompress(
                data[header.end() : header.end() + DECODED[header[2]]], DECODED[header[1]], "zstd", asbytes=True
            ),
            DECODED[header[4]],
        )
    except (ValueError, OSError):
        return None


def _strings(data: bytes, count: int) -> list[str]:
    """Split so many strings, each after its length. Raises: ValueError if there are others."""
    found, at = [], 0
    for _ in range(count):
        end = at + MIN_ENTRY_BYTES + int.from_bytes(data[at : at + MIN_ENTRY_BYTES], "little")
        found.append(data[at + MIN_ENTRY_BYTES : end].decode())
        at = end
    if at != len(data):
        raise ValueError(f"{count} strings of {at} bytes, expected {len(data)}")
    return found


def _footer_at(data: bytes) -> int:
    """Return where the footer begins. Raises: ValueError if there is none."""
    size, length = len(data), int.from_bytes(data[-8:-4], "little")
    if size < 12 or data[-4:] != MAGIC or length > size - 12:
        raise ValueError(f"{size} bytes that end in {data[-4:]!r}, expected a Parquet file")
    if data[:4] != MAGIC:
        raise ValueError(f"{size} bytes that begin with {data[:4]!r}, expected a Parquet file")
    if length > bounds.MAX_FOOTER_BYTES:
        raise ValueError(f"a footer of {length} bytes, expected at most {bounds.MAX_FOOTER_BYTES}")
    return size - 8 - length


def _chunk(data: bytes, column: Column, at: int) -> tuple[_Chunk, Said | None, int] | None:
    """Read a column's chunk in the footer, and where it goes on; None if it is not written as it must be.

    Raises: ValueError for statistics that are none.
    """
    found = column.chunk.match(data, at + len(column.about)) if data.startswith(column.about, at) else None
    said = None
    rest = found
    if found is not None and column.name == "run_id":
        said, after = _text_bounds(data, found.end(), b"\x19")
        rest = RUN_ID_REST.match(data, after)
    if found is None or rest is None:
        return None
    values, unpacked, stored, data_at, dictionary_at, *stated = found.groups()
    if rest is found and stated[0]:
        said = _integer_bounds(column.name, stated[0])
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
        said,
        rest.end(),
    )


def _text_bounds(data: bytes, at: int, after: bytes) -> tuple[Said | None, int]:
    """Read the statistics of `run_id` that may begin here; return them, and where what comes `after` them ends.

    Raises: ValueError if they are not as they may be.
    """
    if data[at : at + 1] == b"\x29":
        return None, at + 1
    if data.startswith(without := UNBOUNDED + after, at):
        return None, at + len(without)
    if (most := MOST.match(data, at)) and (least := LEAST.match(data, most.end() + (most_bytes := _length(most[1])))):
        end = BOUNDS_END.match(data, least.end() + (least_bytes := _length(least[1])))
        if (
            end is not None
            and data.startswith(after, end.end())
            and max(most_bytes, least_bytes) <= bounds.MAX_BOUND_BYTES
        ):
            said = Said(
                "run_id", data[least.end() : least.end() + least_bytes], data[most.end() : most.end() + most_bytes]
            )
            return said, end.end() + len(after)
    raise ValueError("other statistics of column run_id, expected most, least and no NULL")


def _page_bounds(data: bytes, name: str, header: re.Match[bytes]) -> tuple[Said | None, int]:
    """Read the statistics of the page with this header; return them, and where its body begins.

    Raises: ValueError if they are not as they may be.
    """
    if header[6] is None:
        return _text_bounds(data, header.end() - 1, b"\x00\x00")
    return _integer_bounds(name, header[7]) if header.lastindex == 7 else None, header.end()


def _length(data: bytes) -> int:
    """Decode a Thrift length."""
    return data[0] if len(data) == 1 else data[0] & 0x7F | data[1] << 7


def _integer_bounds(name: str, stated: bytes) -> Said:
    """Read the statistics of a column of integers. Raises: ValueError if they say two things."""
    found = INTEGER_BOUNDS.fullmatch(stated)
    assert found is not None
    most, least, most_again, least_again = found.groups()
    if (most, least) != (most_again, least_again):
        raise ValueError(
            f"statistics of column {name} that say {least!r} to {most!r} and {least_again!r} to {most_again!r}, "
            "expected them once"
        )
    return Said(name, least, most)


def _check_chunk(chunk: _Chunk, rows: int, place: int) -> None:
    """Check that the chunk begins at this place and has a value for each row. Raises: ValueError if not."""
    name, kind = chunk.column.name, chunk.column.kind
    if kind == "strings":
        if chunk.values < rows:
            raise ValueError(f"column {name}: {chunk.values} values, expected at least {rows}")
    elif chunk.values != rows:
        raise ValueError(f"column {name}: {chunk.values} values, expected {rows}")
    has_dictionary = kind in ("string", "strings")
    begin = chunk.dictionary_at if has_dictionary else chunk.data_at
    if begin != place:
        raise ValueError(f"column {name}: pages from byte {begin}, expected from byte {place}, where those before end")


def _check_pages(data: bytes, chunk: _Chunk, place: int, of_pages: list[Said]) -> int:
    """Check the pages of this chunk, collect what they say of their rows, and return where they end.

    Raises: ValueError if they are not what it says.
    """
    name, has_dictionary = chunk.column.name, chunk.column.kind in ("string", "strings")
    at, end = place, place + chunk.stored
    values = plain = pages = unpacked = 0
    if has_dictionary:
        at, unpacked = _check_dictionary(data, name, at)
    if at != chunk.data_at:
        raise ValueError(f"column {name}: data from byte {chunk.data_at}, expected from byte {at}")
    match = chunk.column.page.match
    while at < end:
        header = match(data, at)
        if header is None:
            raise ValueError(f"column {name}: {explain_page(data, at)}")
        pages += 1
        if pages > bounds.MAX_PAGES:
            raise ValueError(f"column {name}: more than {bounds.MAX_PAGES} pages, expected fewer")
        said, body = _page_bounds(data, name, header)
        of_pages += [said._replace(rows=(values, DECODED[header[4]]))] if said else []
        stored = DECODED[header[2]]
        _check_sum(data, name, body, stored, header[3])
        values += DECODED[header[4]]
        plain += header[5] == b"\x00"
        unpacked += DECODED[header[1]] + body - at
        at = body + stored
    if at != end:
        raise ValueError(f"column {name}: a page that ends at byte {at}, expected it to end by {end}")
    if values != chunk.values:
        raise ValueError(f"column {name}: pages of {values} values, expected {chunk.values}")
    if unpacked != chunk.unpacked:
        raise ValueError(
            f"column {name}: pages that unpack to {unpacked} bytes with their headers, expected {chunk.unpacked}"
        )
    if chunk.encodings != encoding_statistics(chunk.column.kind, pages - plain if has_dictionary else pages, plain):
        raise ValueError(f"column {name}: other encodings than those of its {pages} pages, expected those")
    return end


def _check_dictionary(data: bytes, name: str, at: int) -> tuple[int, int]:
    """Return where the dictionary that begins here ends, and the bytes that it unpacks to, header included.

    Raises: ValueError if there is none.
    """
    header = DICTIONARY_PAGE.match(data, at)
    if header is None:
        raise ValueError(f"column {name}: {explain_page(data, at)}")
    unpacked, stored, values = DECODED[header[1]], DECODED[header[2]], DECODED[header[4]]
    if values * MIN_ENTRY_BYTES > unpacked:
        raise ValueError(
            f"column {name}: a dictionary of {values} values in {unpacked} bytes, expected at least {MIN_ENTRY_BYTES} "
            "bytes each"
        )
    _check_sum(data, name, header.end(), stored, header[3])
    return header.end() + stored, unpacked + header.end() - at


def _check_sum(data: bytes, name: str, at: int, stored: int, said: bytes) -> None:
    """Compare the stored bytes of a page with the checksum in its header. Raises: ValueError if they differ."""
    value = unsigned(said)
    if (found := crc32(data[at : at + stored])) != (value >> 1 ^ -(value & 1)) & 0xFFFFFFFF:
        raise ValueError(f"column {name}: a page at byte {at} with the checksum {found}, expected that of its header")
