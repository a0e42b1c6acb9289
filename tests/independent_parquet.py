"""A Parquet reader for the second verifier, written from parquet-format and section 5 of docs/ledger-format.md.

It accounts for every byte of a file. It shares nothing with the package or with the libraries that the package reads
by; pyarrow only unpacks zstd here.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import pyarrow as pa
from independent_pages import DELTA, PLAIN, RLE, RLE_DICTIONARY, assembled, ended, levels, read_values  # type: ignore[import-not-found]
from independent_thrift import FOOTER, PAGE, Bytes  # type: ignore[import-not-found]

MAX_FILE_BYTES, MAX_FOOTER_BYTES, MAX_HEADER_BYTES, MAX_BOUND_BYTES = 1 << 27, 1 << 20, 1 << 14, 1 << 12
MAX_ROWS, MAX_PAGES, MAX_LIST_VALUES, MAX_UNPACKED_BYTES, MAX_TEXT_BYTES = 1 << 20, 1 << 10, 1 << 22, 1 << 27, 1 << 29
ZSTD = 6
BOOLEAN, INT64, BYTE_ARRAY = 0, 2, 6
REQUIRED, OPTIONAL, REPEATED = 0, 1, 2
DATA, DICTIONARY = 0, 2
STRING = {"type": BYTE_ARRAY, "converted_type": 0, "logical_type": {"string": {}}}
ENCODINGS = {BOOLEAN: [RLE, PLAIN], INT64: [RLE, DELTA], BYTE_ARRAY: [PLAIN, RLE, RLE_DICTIONARY]}
STATED = {
    "run_id": {"max_value", "min_value"},
    "seq": {"max", "min", "max_value", "min_value"},
    "time_us": {"max", "min", "max_value", "min_value"},
}
LEAVES = {"string": STRING, "int64": {"type": INT64}, "bool": {"type": BOOLEAN}}
Values = list[Any]


class Leaf(NamedTuple):
    """A stored column: its text in the fingerprint, its path, its physical type and its highest levels."""

    text: str
    path: list[str]
    type: int
    definition: int
    repetition: int


class Page(NamedTuple):
    """A page: its header, and its bytes as stored."""

    header: dict[str, Any]
    data: bytes


def must(found: object, expected: object, what: str) -> None:
    if found != expected:
        raise ValueError(f"{what} {found!r:.100}, not {expected!r:.100}")


@lru_cache(16)  # many ledgers differ in other files; nobody changes what is returned
def read(data: bytes) -> tuple[int, list[tuple[str, str]], dict[str, Values]]:
    """Read everything in a segment: its rows, its columns as the fingerprint has them, and their values.

    Raises ValueError for anything that a segment may not hold.
    """
    length = int.from_bytes(data[-8:-4], "little")
    must(
        (data[:4], data[-4:], len(data) <= MAX_FILE_BYTES, length <= min(MAX_FOOTER_BYTES, len(data) - 12)),
        (b"PAR1", b"PAR1", True, True),
        "a file of",
    )
    footer = Bytes(data[-8 - length : -8])
    found = footer.struct(FOOTER)
    ended(footer)
    leaves = read_schema(found["schema"])
    rows = found["num_rows"]
    must((found["version"], len(found["groups"]), 0 < rows <= MAX_ROWS), (2, 1, True), "a version, row groups, rows")
    must(found["column_orders"], [{"by_type": {}}] * len(leaves), "orders of columns")
    must(
        re.fullmatch("parquet-cpp-arrow version [-.0-9A-Za-z]{1,40}", found["created_by"]) is not None,
        True,
        "a writer that is known:",
    )
    (group,) = found["groups"]
    columns = [chunk["column"] for chunk in group["chunks"]]
    must(len(columns), len(leaves), "column chunks")
    must((group["num_rows"], group["file_offset"]), (rows, 4), "a row group of")
    must(
        group["unpacked_bytes"], sum(column["unpacked_bytes"] for column in columns), "unpacked bytes of the row group"
    )
    must(group["stored_bytes"], sum(column["stored_bytes"] for column in columns), "stored bytes of the row group")
    must(any(chunk["file_offset"] for chunk in group["chunks"]), False, "a place of a column's metadata")
    at, values, unpacked, listed = 4, {}, 0, 0
    for leaf, column in zip(leaves, columns, strict=True):
        try:
            pages = list(read_layout(data[: -8 - length], at, leaf, column, rows))
            unpacked += column["unpacked_bytes"]
            listed += column["num_values"] - rows
            must(unpacked <= MAX_UNPACKED_BYTES, True, "so much unpacked")
            must(listed <= MAX_LIST_VALUES, True, "so many values of lists")
            values[leaf.path[0]] = read_column(leaf, column, pages, rows)
        except (ValueError, OSError, pa.ArrowException) as error:
            raise ValueError(f"column {leaf.path[0]}: {error}") from error
        at += column["stored_bytes"]
    must(at, len(data) - 8 - length, "the end of the last column at byte")
    must(sum(map(text_bytes, values.values())) <= MAX_TEXT_BYTES, True, "so many strings")
    return rows, [(leaf.path[0], leaf.text) for leaf in leaves], values


def read_schema(elements: list[dict[str, Any]]) -> list[Leaf]:
    """Return the leaves of a flat schema of strings, integers, booleans and lists of strings."""
    root, *rest = elements
    rest.reverse()
    leaves = []
    for _ in range(root.pop("children", 0)):
        if not rest:
            raise ValueError("fewer columns than the schema says")
        about = rest.pop()
        name, repetition = about.pop("name"), about.pop("repetition", None)
        texts = [text for text, leaf in LEAVES.items() if about == leaf and repetition in (REQUIRED, OPTIONAL)]
        if texts:
            text = texts[0] + (" not null" if repetition == REQUIRED else "")
            leaves.append(Leaf(text, [name], about["type"], repetition, 0))
        else:
            expected = {"children": 1, "converted_type": 3, "logical_type": {"list": {}}}
            must((about, repetition, len(rest) > 1), (expected, OPTIONAL, True), f"{name} as")
            must(rest.pop(), {"name": "list", "repetition": REPEATED, "children": 1}, f"within {name}")
            must(rest.pop(), {"name": "element", "repetition": REQUIRED, **STRING}, f"within {name}.list")
            leaves.append(Leaf("list<element: string not null>", [name, "list", "element"], BYTE_ARRAY, 2, 1))
    must((root, rest), ({"name": "schema", "repetition": REQUIRED}, []), "the root of the schema")
    if len({leaf.path[0] for leaf in leaves}) != len(leaves):
        raise ValueError("a column twice")
    return leaves


def read_layout(data: bytes, at: int, leaf: Leaf, column: dict[str, Any], rows: int) -> Iterator[Page]:
    """Return the pages of the column chunk at this byte, after checking what chunk and pages say of themselves."""
    must((column["type"], column["path"], column["codec"]), (leaf.type, leaf.path, ZSTD), "a type, path and codec")
    must(
        (column["encodings"], "dictionary_offset" in column),
        (ENCODINGS[leaf.type], leaf.type == BYTE_ARRAY),
        "encodings, and a dictionary",
    )
    end, values, unpacked = at + column["stored_bytes"], 0, 0
    dictionary, first, counts = None, None, dict[tuple[int, int], int]()
    while at < end:
        reader = Bytes(data[at : min(end, at + MAX_HEADER_BYTES)])
        header = reader.struct(PAGE)
        kind, stored = header["type"], header["stored_bytes"]
        name = {DATA: "data", DICTIONARY: "dictionary"}.get(kind)
        must(
            (header.keys() & {"data", "dictionary"}, min(stored, header["unpacked_bytes"]) >= 0),
            ({name}, True),
            "a page with",
        )
        must(
            kind == DICTIONARY,
            dictionary is None and "dictionary_offset" in column,
            "a dictionary, only before the data:",
        )
        dictionary, first = (at, first) if kind == DICTIONARY else (dictionary, at if first is None else first)
        page = data[at + reader.at : at + reader.at + stored]
        must(len(page) == stored and at + reader.at + stored <= end, True, "a page within its chunk:")
        values += check_page(header, page)
        key = kind, header[name]["encoding"]
        counts[key] = counts.get(key, 0) + 1
        unpacked += reader.at + header["unpacked_bytes"]
        must(
            sum(counts.values()) - (dictionary is not None) <= MAX_PAGES and unpacked <= MAX_UNPACKED_BYTES,
            True,
            "so many pages, or such large ones:",
        )
        at += reader.at + stored
        yield Page(header, page)
    must(at, end, "the end of the last page at byte")
    must(
        (column["data_offset"], column.get("dictionary_offset"), column["unpacked_bytes"]),
        (first, dictionary, unpacked),
        "offsets and unpacked bytes",
    )
    must((column["num_values"], values if leaf.repetition else rows), (values, values), "values")
    must(values <= rows + (MAX_LIST_VALUES if leaf.repetition else 0), True, "so many values:")
    stats = [((each["page_type"], each["encoding"]), each["count"]) for each in column["encoding_stats"]]
    must(
        stats,
        sorted(counts.items(), key=lambda item: (item[0][0] != DICTIONARY, item[0])),
        "pages by kind and encoding",
    )


def check_page(header: dict[str, Any], page: bytes) -> int:
    """Check a page against its header; return how many values it adds to its column, 0 for a dictionary."""
    must(header["crc"] & 0xFFFFFFFF, zlib.crc32(page), "a checksum")
    if header["type"] == DICTIONARY:
        about = header["dictionary"]
        must((about["encoding"], about["is_sorted"]), (PLAIN, False), "a dictionary in PLAIN, in an order")
        return 0
    about = header["data"]
    must(
        (about["definition_encoding"], about["repetition_encoding"], about["num_values"] >= 0),
        (RLE, RLE, True),
        "levels encoded, and values",
    )
    return int(about["num_values"])


def read_column(leaf: Leaf, column: dict[str, Any], pages: list[Page], rows: int) -> Values:
    """Return the values of a column, one a row, after checking the statistics of it and of its pages."""
    values: Values = []
    dictionary = None
    repetitions: list[int] = []
    definitions: list[int] = []
    for header, stored in pages:
        raw = pa.Codec("zstd").decompress(stored, header["unpacked_bytes"], asbytes=True)
        must(len(raw), header["unpacked_bytes"], "unpacked bytes of a page")
        reader = Bytes(raw)
        if header["type"] == DICTIONARY:
            dictionary = read_values(reader, leaf.type, PLAIN, header["dictionary"]["num_values"], None)
            continue
        about = header["data"]
        again = levels(reader, leaf.repetition, about["num_values"])
        defined = levels(reader, leaf.definition, about["num_values"])
        own = read_values(reader, leaf.type, about["encoding"], defined.count(leaf.definition), dictionary)
        check_statistics(about["statistics"], leaf, own, len(defined) - len(own))
        values, repetitions, definitions = values + own, repetitions + again, definitions + defined
    must(column.get("statistics") != {}, True, "no statistics of a column, or some: not empty ones,")
    check_statistics(column.get("statistics", {}), leaf, values, len(definitions) - len(values))
    check_sizes(column.get("sizes", {}), leaf, values, repetitions, definitions)
    found: Values = assembled(values, repetitions, definitions, leaf.definition)
    must(len(found), rows, "rows of a column")
    return found


def check_statistics(said: dict[str, Any], leaf: Leaf, own: Values, nulls: int) -> None:
    """Check that the statistics, where present, are complete and right for these rows.

    `run_id` may be too long for bounds.
    """
    if not said or (leaf.path[0] == "run_id" and said == {"null_count": nulls}):
        return
    exact = {"is_max_value_exact", "is_min_value_exact"} & said.keys()
    must(
        (leaf.path[0] in STATED, len(exact) != 1, bool(own)),
        (True, True, True),
        "statistics of this column, of some values:",
    )
    expected = dict.fromkeys(exact, True) | {
        name: bound(max(own) if "max" in name else min(own)) for name in STATED[leaf.path[0]]
    }
    must(said, expected | {"null_count": nulls}, "statistics")
    must(max(len(said["max_value"]), len(said["min_value"])) <= MAX_BOUND_BYTES, True, "such long bounds")


def bound(value: Any) -> bytes:
    return value.encode() if isinstance(value, str) else struct.pack("<q", value)


def check_sizes(said: dict[str, Any], leaf: Leaf, own: Values, repetitions: list[int], definitions: list[int]) -> None:
    """Check that the sizes, where present, are right: bytes of all strings, and how often each level occurs."""
    if said:
        counted = [
            [found.count(level) for level in range(most + 1)] if most else []
            for found, most in ((repetitions, leaf.repetition), (definitions, leaf.definition))
        ]
        texts = {"unencoded": text_bytes(own)} if leaf.type == BYTE_ARRAY else {}
        must(said, texts | {"repetitions": counted[0], "definitions": counted[1]}, "sizes")


def text_bytes(values: Values) -> int:
    return sum(
        len(value.encode()) if isinstance(value, str) else text_bytes(value)
        for value in values
        if isinstance(value, str | list)
    )
