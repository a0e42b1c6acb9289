"""The Parquet reader of the second verifier reads what the library reads, and nothing that says a thing in two ways."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.ledger import segment
from fsar_ledger.ledger.codec import encode
from tests.ledger import parquet_forgery as forgery
from tests.ledger.agreement import OTHER_VERSION, VERSION, independent, odd_run, with_value
from tests.ledger.parquet_forgery import BINARY, I16, I32, I64, LIST, STRUCT, TRUE, about, altered_page, chunk, field, footer_of, value, with_footer
from tests.ledger.samples import made_up_run

STATED = ["run_id", "seq", "time_us", "reason", "is_audited"]
TABLE = encode([made_up_run("a run", 40, 1), odd_run("\u2028", 9, random.Random(2))])
DATA = bytes(segment.to_parquet(TABLE))
SEQ, TIME, TYPE = 1, 2, 4


def read(data: bytes) -> tuple[int, list[tuple[str, str]], dict[str, list[Any]]]:
    found: tuple[int, list[tuple[str, str]], dict[str, list[Any]]] = independent().independent_parquet.read(data)
    return found


def rows_of(table: pa.Table) -> dict[str, list[Any]]:
    return {name: table.column(name).to_pylist() for name in table.column_names}


def packed(table: pa.Table, **settings: Any) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, **{"store_schema": False, "write_statistics": STATED, **settings})
    return bytes(sink.getvalue())


def test_it_reads_what_the_library_reads() -> None:
    for data in (DATA, *(file.read_bytes() for file in sorted(Path("tests/ledgers/0.1.0/ledger/segments").glob("*")))):
        table = pq.read_table(pa.BufferReader(data))
        expected = [(column.name, f"{column.type}{'' if column.nullable else ' not null'}") for column in table.schema]
        assert read(data) == (table.num_rows, expected, rows_of(table))


ENCODED = {"seq": "BYTE_STREAM_SPLIT", "caused_by": "BYTE_STREAM_SPLIT", "run_id": "DELTA_LENGTH_BYTE_ARRAY", "robot": "DELTA_LENGTH_BYTE_ARRAY"}


@pytest.mark.parametrize("codec", ["none", "snappy", "zstd"])
@pytest.mark.parametrize(
    "settings",
    [
        {"use_dictionary": True, "data_page_size": 100, "write_batch_size": 5},
        {"use_dictionary": False, "data_page_size": 100, "write_batch_size": 5},
        {"use_dictionary": True, "dictionary_pagesize_limit": 60, "write_batch_size": 5, "write_page_checksum": True},
        {"use_dictionary": False, "column_encoding": {**ENCODED, "is_audited": "RLE", "time_us": "DELTA_BINARY_PACKED"}, "version": "1.0"},
    ],
)
def test_it_reads_every_encoding_and_codec_that_a_segment_may_have(codec: str, settings: dict[str, Any]) -> None:
    assert read(packed(TABLE, compression=codec, **settings))[2] == rows_of(TABLE)


def test_it_reads_integers_of_any_size_in_differences() -> None:
    draw = random.Random(3)
    numbers = [draw.choice([0, 1 - 2**53, 2**53 - 1, draw.randrange(-(2**40), 2**40), number]) for number in range(300)]
    for count in (1, 2, 32, 33, 128, 129, 300):
        table = TABLE.take([0] * count)
        table = table.set_column(TIME, TABLE.schema.field("time_us"), pa.array(numbers[:count]))
        assert read(bytes(segment.to_parquet(table)))[2]["time_us"] == numbers[:count]


# --- what must not be ---


def footed(alter: Callable[[forgery.Tree], None]) -> bytes:
    """The file with another footer."""
    body, footer = footer_of(DATA)
    alter(footer)
    return with_footer(body, footer)


def two_faces(data: bytes, other: bytes, column: int) -> bytes:
    """A column has the values of the first file where its data page is said to be, and those of the other where its dictionary is."""
    body, footer = footer_of(data)
    elsewhere, meta = footer_of(other)[0], about(footer_of(other)[1], column)
    start = min(each[2] for each in meta if each[0] in (9, 11))
    forgery.put(about(footer, column), 11, I64, len(body))
    return with_footer(body + elsewhere[start : start + value(meta, 7)], footer).replace(VERSION, OTHER_VERSION)


def with_gap(at_column: int) -> bytes:
    """Bytes that nobody reads before a column."""
    body, footer = footer_of(DATA)
    at = value(about(footer, at_column), 9)
    forgery.moved(footer, at, 5)
    return with_footer(body[:at] + b"aside" + body[at:], footer)


def swapped(one: int, other: int) -> bytes:
    """Two columns lie in the file in the other order; each is where the footer says."""
    body, footer = footer_of(DATA)
    starts = [min(each[2] for each in about(footer, column) if each[0] in (9, 11)) for column in (one, other)]
    sizes = [value(about(footer, column), 7) for column in (one, other)]
    assert starts[0] + sizes[0] == starts[1]
    for column, by in ((one, sizes[1]), (other, -sizes[0])):
        for each in about(footer, column):
            each[2] = each[2] + by if each[0] in (9, 11) else each[2]
    moved = body[starts[1] : starts[1] + sizes[1]] + body[starts[0] : starts[1]]
    return with_footer(body[: starts[0]] + moved + body[starts[1] + sizes[1] :], footer)


def plus(by: int, *numbers: int) -> Callable[[forgery.Tree], None]:
    def alter(footer: forgery.Tree) -> None:
        tree = about(footer, TYPE)
        for number in numbers[:-1]:
            tree = value(tree, number)
        field(tree, numbers[-1])[2] += by

    return alter


def in_page(column: int, page: int, number: int, kind: int, new: Any) -> bytes:
    return altered_page(DATA, column, page, lambda header: forgery.put(header, number, kind, new))


DAMAGED: dict[str, Callable[[], bytes]] = {
    "two faces": lambda: two_faces(DATA, bytes(segment.to_parquet(with_value(TABLE, "time_us", 3, 4242))), TIME),
    "bytes before the footer": lambda: with_footer(footer_of(DATA)[0] + b"aside", footer_of(DATA)[1]),
    "bytes between columns": lambda: with_gap(SEQ),
    "columns in another order in the file": lambda: swapped(SEQ, TIME),
    "bytes behind the fields of the footer": lambda: DATA[:-8] + b"\0" + (int.from_bytes(DATA[-8:-4], "little") + 1).to_bytes(4, "little") + b"PAR1",
    "fewer values": lambda: footed(plus(-1, 5)),
    "more values": lambda: footed(plus(1, 5)),
    "a larger column": lambda: footed(plus(1, 7)),
    "a column that unpacks to more": lambda: footed(plus(1, 6)),
    "a dictionary elsewhere": lambda: footed(plus(1, 11)),
    "a data page elsewhere": lambda: footed(plus(1, 9)),
    "another codec": lambda: footed(plus(-5, 4)),
    "another type": lambda: footed(plus(-4, 1)),
    "more rows in the file": lambda: footed(lambda footer: forgery.put(footer, 3, I64, 50)),
    "more rows in the row group": lambda: footed(lambda footer: forgery.put(value(footer, 4, 0), 3, I64, 50)),
    "a larger row group": lambda: footed(lambda footer: forgery.put(value(footer, 4, 0), 2, I64, 50)),
    "a row group elsewhere": lambda: footed(lambda footer: forgery.put(value(footer, 4, 0), 5, I64, 50)),
    "another number of the row group": lambda: footed(lambda footer: forgery.put(value(footer, 4, 0), 7, I16, 1)),
    "key-value metadata": lambda: footed(lambda footer: forgery.put(footer, 5, LIST, (STRUCT, [[[1, BINARY, b"key"], [2, BINARY, b"value"]]]))),
    "metadata of a column": lambda: footed(lambda footer: forgery.put(about(footer, TYPE), 8, LIST, (STRUCT, [[[1, BINARY, b"key"]]]))),
    "a column in another file": lambda: footed(lambda footer: forgery.put(chunk(footer, TYPE), 1, BINARY, b"other.parquet")),
    "an encrypted column": lambda: footed(lambda footer: forgery.put(chunk(footer, TYPE), 9, BINARY, b"secret")),
    "a Bloom filter": lambda: footed(lambda footer: forgery.put(about(footer, TYPE), 14, I64, 4)),
    "a page index": lambda: footed(lambda footer: forgery.put(chunk(footer, TYPE), 4, I64, 4)),
    "an order of rows": lambda: footed(lambda footer: forgery.put(value(footer, 4, 0), 4, LIST, (STRUCT, [[[1, I32, 0], [2, TRUE, True], [3, TRUE, True]]]))),
    "a field that nobody knows": lambda: footed(lambda footer: forgery.put(about(footer, TYPE), 19, I64, 4)),
    "a field twice": lambda: footed(lambda footer: about(footer, TYPE).append([5, I64, 49])),
    "a field as another type": lambda: footed(lambda footer: forgery.put(about(footer, TYPE), 5, I32, 49)),
    "an encoding that no page has": lambda: footed(lambda footer: forgery.put(about(footer, TYPE), 2, LIST, (I32, [0, 3, 8, 6]))),
    "other counts of pages": lambda: footed(lambda footer: forgery.put(value(about(footer, TYPE), 13, 0), 3, I32, 2)),
    "other counts of levels": lambda: footed(lambda footer: forgery.put(value(about(footer, 3), 16), 3, LIST, (I64, [3, 46]))),
    "a lie about the longest": lambda: footed(lambda footer: forgery.put(value(about(footer, TYPE), 16), 1, I64, 7)),
    "a wrong checksum": lambda: in_page(TYPE, 1, 4, I32, 77),
    "a page of fewer values": lambda: altered_page(DATA, SEQ, 0, lambda header: forgery.put(value(header, 5), 1, I32, 48)),
    "a page in another encoding": lambda: altered_page(DATA, SEQ, 0, lambda header: forgery.put(value(header, 5), 2, I32, 0)),
    "a page with two kinds of header": lambda: in_page(SEQ, 0, 7, STRUCT, [[1, I32, 1], [2, I32, 0]]),
    "statistics of a page that lie": lambda: in_page(SEQ, 0, 5, STRUCT, [[1, I32, 49], [2, I32, 5], [3, I32, 3], [4, I32, 3], [5, STRUCT, [[3, I64, 7]]]]),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_says_a_thing_in_two_ways_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read(DAMAGED[name]())


def test_the_file_with_two_faces_has_them(tmp_path: Path) -> None:
    """Readers that begin at the data and readers that begin at the dictionary see other rows in it, and neither complains."""
    file = tmp_path / "faces.parquet"
    file.write_bytes(DAMAGED["two faces"]())
    altered = with_value(TABLE, "time_us", 3, 4242).column("time_us").to_pylist()
    assert pq.read_table(file, page_checksum_verification=True).column("time_us").equals(TABLE.column("time_us"))
    with duckdb.connect() as connection:
        found = connection.execute(f"SELECT time_us FROM '{file}'").fetchall()
    assert [time for (time,) in found] == altered != TABLE.column("time_us").to_pylist()


def test_the_forger_changes_nothing_but_what_it_means_to() -> None:
    body, footer = footer_of(DATA)
    assert with_footer(body, footer) == DATA
    assert altered_page(DATA, TYPE, 1, lambda header: None) == DATA
    assert read(footed(lambda footer: forgery.put(footer, 6, BINARY, b"somebody else")))[2] == rows_of(TABLE)
    without = altered_page(DATA, TYPE, 1, lambda header: header.remove(field(header, 4)))
    assert read(without)[2] == rows_of(TABLE)


def test_no_number_of_a_footer_can_be_another() -> None:
    """But the version: 1 and 2 mean the same."""
    draw = random.Random(4)
    for _ in range(60):
        body, footer = footer_of(DATA)
        number = draw.choice([number for number in numbers_in(footer) if number is not field(footer, 1)])
        number[2] += draw.choice([-1, 1, 7, -(2**31)])
        with pytest.raises(ValueError, match=r"."):
            read(with_footer(body, footer))


def numbers_in(tree: forgery.Tree) -> list[forgery.Field]:
    """Every field that is a number, at any depth."""
    found = []
    for each in tree:
        kind, inner = each[1], each[2]
        found += [each] if kind in (I16, I32, I64) else []
        trees = [inner] if kind == STRUCT else inner[1] if kind == LIST and inner[0] == STRUCT else []
        found += [number for one in trees for number in numbers_in(one)]
    return found
