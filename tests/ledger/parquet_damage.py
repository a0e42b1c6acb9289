"""Ways to say a thing twice in a Parquet file, or to say what nobody reads: each makes one segment into another that a verifier must refuse."""

from collections.abc import Callable
from typing import Any

from tests.ledger.agreement import OTHER_VERSION, VERSION
from tests.ledger.parquet_forgery import (
    BINARY,
    I16,
    I32,
    I64,
    LIST,
    STRUCT,
    TRUE,
    Tree,
    about,
    altered_page,
    chunk,
    field,
    footer_of,
    moved,
    put,
    start_of,
    value,
    with_footer,
)

SEQ, TIME, CAUSE, TYPE = 1, 2, 3, 4
"""Columns of every segment, by their places."""

Damage = Callable[[bytes], bytes]
Alter = Callable[[Tree], None]


def footed(alter: Alter) -> Damage:
    """The file with another footer."""

    def damage(data: bytes) -> bytes:
        body, footer = footer_of(data)
        alter(footer)
        return with_footer(body, footer)

    return damage


def in_group(alter: Alter) -> Damage:
    """The file with another row group."""
    return footed(lambda footer: alter(value(footer, 4, 0)))


def in_column(alter: Alter, column: int = TYPE) -> Damage:
    """The file with other metadata of a column chunk."""
    return footed(lambda footer: alter(about(footer, column)))


def plus(by: int, number: int) -> Alter:
    """The field says so much more."""

    def alter(tree: Tree) -> None:
        field(tree, number)[2] += by

    return alter


def set_to(number: int, kind: int, new: Any) -> Alter:
    """The field says this."""
    return lambda tree: put(tree, number, kind, new)


def in_page(alter: Alter, column: int = SEQ, page: int = 0) -> Damage:
    """The file with another page header; offsets and sizes are made to fit."""
    return lambda data: altered_page(data, column, page, alter)


def two_faces(data: bytes, other: bytes, column: int) -> bytes:
    """A column has its values where its data page is said to be, and those of the other file where its dictionary is said to be.

    The attack on 0.1.0: pyarrow reads the ones, DuckDB and Polars read the others.
    """
    body, footer = footer_of(data)
    elsewhere, others = footer_of(other)
    start = start_of(others, column)
    put(about(footer, column), 11, I64, len(body))
    return with_footer(body + elsewhere[start : start + value(about(others, column), 7)], footer).replace(VERSION, OTHER_VERSION)


def with_gap(data: bytes) -> bytes:
    """Bytes that nobody reads lie before a column."""
    body, footer = footer_of(data)
    at = start_of(footer, SEQ)
    moved(footer, at, 5)
    return with_footer(body[:at] + b"aside" + body[at:], footer)


def swapped(data: bytes) -> bytes:
    """Two columns lie in the file in the other order; each is where the footer says."""
    body, footer = footer_of(data)
    first, second, end = (start_of(footer, column) for column in (SEQ, TIME, CAUSE))
    field(about(footer, SEQ), 9)[2] += end - second
    field(about(footer, TIME), 9)[2] -= second - first
    return with_footer(body[:first] + body[second:end] + body[first:second] + body[end:], footer)


def longer_footer(data: bytes) -> bytes:
    """A byte behind the fields of the footer is said to be of it."""
    body, _ = footer_of(data)
    footer = data[len(body) : -8] + b"\0"
    return body + footer + len(footer).to_bytes(4, "little") + b"PAR1"


KEY_AND_VALUE = (STRUCT, [[[1, BINARY, b"key"], [2, BINARY, b"value"]]])
IN_ORDER = (STRUCT, [[[1, I32, 0], [2, TRUE, True], [3, TRUE, True]]])

DAMAGED: dict[str, Damage] = {
    "bytes before the footer": lambda data: with_footer(footer_of(data)[0] + b"aside", footer_of(data)[1]),
    "bytes between columns": with_gap,
    "columns in another order in the file": swapped,
    "bytes behind the fields of the footer": longer_footer,
    "fewer values": in_column(plus(-1, 5)),
    "more values": in_column(plus(1, 5)),
    "a larger column": in_column(plus(1, 7)),
    "a column that unpacks to more": in_column(plus(1, 6)),
    "a dictionary elsewhere": in_column(plus(1, 11)),
    "no dictionary": in_column(lambda tree: tree.remove(field(tree, 11))),
    "a dictionary where there is none": in_column(set_to(11, I64, 0), SEQ),
    "a data page elsewhere": in_column(plus(1, 9)),
    "another codec": in_column(plus(-5, 4)),
    "another type": in_column(plus(-4, 1)),
    "another version": footed(plus(7, 1)),
    "more rows in the file": footed(plus(1, 3)),
    "more rows in the row group": in_group(plus(1, 3)),
    "a larger row group": in_group(plus(1, 2)),
    "a larger row group as it is stored": in_group(plus(1, 6)),
    "a row group elsewhere": in_group(set_to(5, I64, 50)),
    "another number of the row group": in_group(set_to(7, I16, 1)),
    "key-value metadata": footed(set_to(5, LIST, KEY_AND_VALUE)),
    "key-value metadata of a column": in_column(set_to(8, LIST, KEY_AND_VALUE)),
    "a column in another file": footed(lambda footer: put(chunk(footer, TYPE), 1, BINARY, b"other.parquet")),
    "the metadata of a column elsewhere": footed(lambda footer: put(chunk(footer, TYPE), 2, I64, 4)),
    "an encrypted column": footed(lambda footer: put(chunk(footer, TYPE), 9, BINARY, b"secret")),
    "a page index": footed(lambda footer: put(chunk(footer, TYPE), 4, I64, 4)),
    "a Bloom filter": in_column(set_to(14, I64, 4)),
    "an order of rows": in_group(set_to(4, LIST, IN_ORDER)),
    "another order of columns": footed(lambda footer: value(footer, 7)[1].pop()),
    "a field that nobody knows": in_column(set_to(19, I64, 4)),
    "a field of the footer that nobody knows": footed(set_to(30, I64, 4)),
    "a field twice": in_column(lambda tree: tree.append([5, I64, value(tree, 5)])),
    "a field of the footer twice": footed(lambda footer: footer.insert(3, [3, I64, value(footer, 3)])),
    "a field as another type": in_column(lambda tree: put(tree, 5, I32, value(tree, 5))),
    "an encoding that no page has": in_column(set_to(2, LIST, (I32, [0, 3, 8, 6]))),
    "other counts of pages": in_column(lambda tree: put(value(tree, 13, 0), 3, I32, 2)),
    "a count of distinct values": in_column(lambda tree: put(value(tree, 12), 4, I64, 1), SEQ),
    "a lie about all strings": in_column(lambda tree: put(value(tree, 16), 1, I64, 7)),
    "a wrong checksum": in_page(plus(1, 4)),
    "a page of fewer values": in_page(lambda header: put(value(header, 5), 1, I32, 0)),
    "a page in another encoding": in_page(lambda header: put(value(header, 5), 2, I32, 0)),
    "levels in another encoding": in_page(lambda header: put(value(header, 5), 3, I32, 4)),
    "a page with two kinds of header": in_page(set_to(7, STRUCT, [[1, I32, 1], [2, I32, 0]])),
    "a page that unpacks to more": in_page(plus(1, 2)),
    "statistics of a page that lie": in_page(lambda header: put(value(header, 5), 5, STRUCT, [[3, I64, 7]])),
    "a field of a page that nobody knows": in_page(set_to(12, I32, 7)),
    "a dictionary in an order": in_page(lambda header: put(value(header, 7), 3, TRUE, True), TYPE),
}
"""By name, beside `two_faces`, which needs a second file."""
