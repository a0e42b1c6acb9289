"""Changes to the layout of a segment, each of which a reader must refuse, and the words of the refusal."""

from collections.abc import Callable
from typing import cast

from tests.ledger.parts import Parts
from tests.ledger.thrift import BINARY, FALSE, I32, I64, LIST, STRUCT, TRUE, Field, Listed, Raw, Struct, field, put

Change = Callable[[Parts], object]


def about(parts: Parts, name: str) -> Struct:
    return parts.about(parts.number_of(name))


def header(parts: Parts, name: str, page: int = -1) -> Struct:
    return parts.pages[parts.number_of(name)][page].header


def data_header(parts: Parts, name: str) -> Struct:
    return cast(Struct, field(header(parts, name), 5))


def add(struct: Struct, number: int, change: int) -> None:
    put(struct, number, cast(int, field(struct, number)) + change)


def statistics(parts: Parts, name: str) -> Struct:
    return cast(Struct, field(about(parts, name), 12))


IN_ORDER = Listed(STRUCT, [[Field(1, I32, 0), Field(2, FALSE, 0), Field(3, TRUE, 1)]])
CHANGES: dict[str, tuple[Change, str]] = {
    "another version of the format": (lambda parts: put(parts.footer, 1, 1), "the footer: "),
    "key-value metadata": (
        lambda parts: put(parts.footer, 5, Listed(STRUCT, [[Field(1, BINARY, b"a")]]), LIST),
        "the footer: ",
    ),
    "no rows": (lambda parts: put(parts.footer, 3, 0), "0 rows, expected 1 to"),
    "more rows": (lambda parts: add(parts.footer, 3, 1), "column run_id: 120 values, expected 121"),
    "a writer of another name": (lambda parts: put(parts.footer, 6, b"parquet-mr version 1.2.8"), "the footer: "),
    "a writer whose name is long": (
        lambda parts: put(parts.footer, 6, b"parquet-cpp-arrow version " + b"1" * 41),
        "the footer: ",
    ),
    "a writer whose name is longer than it says": (
        lambda parts: put(parts.footer, 6, Raw(b"\x1bparquet-cpp-arrow version 12")),
        "the footer: ",
    ),
    "no writer": (lambda parts: parts.footer.pop(4), "the footer: "),
    "another order of columns": (
        lambda parts: put(parts.footer, 7, Listed(STRUCT, [[Field(1, STRUCT, [])]] * 121)),
        "the footer: ",
    ),
    "a field after the last": (lambda parts: parts.footer.append(Field(20, I32, 1)), "the footer: "),
    "bytes after the footer": (lambda parts: parts.footer.append(Field(7, LIST, Raw(b"\x0c\x00"))), "the footer: "),
    "no row group": (lambda parts: put(parts.footer, 4, Listed(STRUCT, [])), "the footer: "),
    "the row group twice": (
        lambda parts: put(parts.footer, 4, Listed(STRUCT, [parts.group()] * 2)),
        "the footer: ",
    ),
    "other bytes unpacked in the row group": (lambda parts: add(parts.group(), 2, 1), "bytes unpacked, expected"),
    "other rows in the row group": (lambda parts: add(parts.group(), 3, 1), "a row group of 121 rows, expected 120"),
    "other bytes stored in the row group": (lambda parts: add(parts.group(), 6, 1), "bytes stored, expected"),
    "another place of the row group": (lambda parts: put(parts.group(), 5, 5), "the footer: "),
    "sorted rows": (lambda parts: put(parts.group(), 4, IN_ORDER, LIST), "the footer: "),
    "a column in another file": (lambda parts: put(parts.chunks()[1], 1, b"x", BINARY), "the footer: column seq"),
    "a place of metadata": (lambda parts: put(parts.chunks()[1], 2, 4), "the footer: "),
    "a page index": (lambda parts: put(parts.chunks()[1], 4, 4, I64), "the footer: column seq"),
    "a Bloom filter": (lambda parts: put(parts.about(1), 14, 4, I64), "the footer: column seq"),
    "another codec": (lambda parts: put(parts.about(1), 4, 0), "the footer: column seq"),
    "another type": (lambda parts: put(parts.about(1), 1, 1), "the footer: column seq"),
    "another path": (lambda parts: put(parts.about(1), 3, Listed(BINARY, [b"sequence"])), "the footer: column seq"),
    "another encoding of a chunk": (
        lambda parts: put(parts.about(1), 2, Listed(I32, [3, 0])),
        "the footer: column seq",
    ),
    "columns in another order": (
        lambda parts: parts.chunks().insert(1, parts.chunks().pop(2)),
        "the footer: column seq",
    ),
    "fewer values": (lambda parts: add(about(parts, "seq"), 5, -1), "column seq: 119 values, expected 120"),
    "a list with fewer values than rows": (
        lambda parts: put(about(parts, "achieved"), 5, 119),
        "column achieved: 119 values, expected at least 120",
    ),
    "a list of more values than its pages": (
        lambda parts: add(about(parts, "achieved"), 5, 1),
        "column achieved: pages of ",
    ),
    "other unpacked bytes": (lambda parts: add(about(parts, "seq"), 6, 1), "column seq: pages that unpack to"),
    "more stored bytes": (lambda parts: add(about(parts, "seq"), 7, 1), "column seq: "),
    "data elsewhere": (lambda parts: add(about(parts, "seq"), 9, 1), "column seq: pages from byte"),
    "data after a dictionary elsewhere": (lambda parts: add(about(parts, "type"), 9, 1), "column type: data from byte"),
    "a dictionary elsewhere": (lambda parts: add(about(parts, "type"), 11, 1), "column type: pages from byte"),
    "no dictionary": (lambda parts: about(parts, "type").pop(8), "the footer: "),
    "a dictionary of integers": (lambda parts: put(about(parts, "seq"), 11, 4, I64), "the footer: "),
    "two bounds of integers": (lambda parts: put(statistics(parts, "seq"), 5, bytes(8)), "that say "),
    "bounds of integers that are short": (lambda parts: put(statistics(parts, "seq"), 5, bytes(7)), "the footer: "),
    "a count of NULL": (lambda parts: put(statistics(parts, "seq"), 3, 1), "the footer: column seq"),
    "inexact bounds": (lambda parts: put(statistics(parts, "seq"), 7, 0), "the footer: "),
    "a bound of text that is too long": (
        lambda parts: put(statistics(parts, "run_id"), 5, b"x" * 4097),
        "other statistics of column run_id",
    ),
    "half of the bounds of text": (
        lambda parts: statistics(parts, "run_id").pop(1),
        "other statistics of column run_id",
    ),
    "a field after the bounds of text": (
        lambda parts: put(statistics(parts, "run_id"), 9, 1, I32),
        "other statistics of column run_id",
    ),
    "statistics of another column": (
        lambda parts: put(about(parts, "robot"), 12, [], STRUCT),
        "the footer: column robot",
    ),
    "encodings of other pages": (
        lambda parts: put(cast(Struct, cast(Listed, field(about(parts, "type"), 13)).values[1]), 3, 2),
        "column type: other encodings than those of its 1 pages",
    ),
    "no encodings of pages": (lambda parts: about(parts, "type").pop(9), "the footer: "),
    "histograms of more levels": (
        lambda parts: put(cast(Struct, field(about(parts, "robot"), 16)), 3, Listed(I64, [1, 1, 1])),
        "the footer: ",
    ),
    "key-value metadata of a column": (
        lambda parts: put(about(parts, "type"), 8, Listed(STRUCT, []), LIST),
        "the footer: column type",
    ),
    "a page of another kind": (lambda parts: put(header(parts, "seq"), 1, 3), "a page header"),
    "a page that says to unpack to more": (
        lambda parts: add(header(parts, "seq"), 2, 1),
        "column seq: pages that unpack to",
    ),
    "a page that says to be longer": (lambda parts: add(header(parts, "seq"), 3, 1), "column seq: a page at byte"),
    "a page with another checksum": (lambda parts: put(header(parts, "seq"), 4, 7), "with the checksum"),
    "a dictionary with another checksum": (
        lambda parts: put(header(parts, "type", 0), 4, 7),
        "column type: a page at byte",
    ),
    "a page without a checksum": (lambda parts: header(parts, "seq").pop(3), "a page header"),
    "a page of other values": (
        lambda parts: add(data_header(parts, "seq"), 1, 1),
        "column seq: pages of 121 values, expected 120",
    ),
    "a page in another encoding": (lambda parts: put(data_header(parts, "seq"), 2, 0), "a page header"),
    "text without its dictionary": (
        lambda parts: put(data_header(parts, "type"), 2, 0),
        "column type: other encodings",
    ),
    "levels in another encoding": (lambda parts: put(data_header(parts, "seq"), 3, 4), "a page header"),
    "statistics of a page of text": (
        lambda parts: put(cast(Struct, field(data_header(parts, "run_id"), 5)), 3, 1),
        "other statistics of column run_id",
    ),
    "a field after the statistics of a page": (
        lambda parts: data_header(parts, "run_id").append(Field(9, TRUE, 1)),
        "other statistics of column run_id",
    ),
    "a sorted dictionary": (
        lambda parts: put(cast(Struct, field(header(parts, "type", 0), 7)), 3, 1),
        "column type: a page header",
    ),
    "a dictionary second": (lambda parts: parts.pages[4].reverse(), "column type: a page header"),
    "two dictionaries": (lambda parts: parts.pages[4].insert(1, parts.pages[4][0]), "column type: "),
}
