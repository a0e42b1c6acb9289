"""The Parquet reader of the second verifier reads what the library reads, and nothing that says a thing in two ways."""

import random
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.ledger import segment
from fsar_ledger.ledger.codec import encode
from tests.ledger.agreement import independent, odd_run, with_value
from tests.ledger.parquet_damage import DAMAGED, TIME, TYPE, footed, set_to, two_faces
from tests.ledger.parquet_forgery import BINARY, I16, I32, I64, LIST, STRUCT, Field, Tree, altered_page, field, footer_of, with_footer
from tests.ledger.samples import made_up_run

STATED = ["run_id", "seq", "time_us", "reason", "is_audited"]
TABLE = encode([made_up_run("a run", 40, 1), odd_run("\u2028", 9, random.Random(2))])
DATA = bytes(segment.to_parquet(TABLE))


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


FACES = two_faces(DATA, bytes(segment.to_parquet(with_value(TABLE, "time_us", 3, 4242))), TIME)


@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_says_a_thing_in_two_ways_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read(DAMAGED[name](DATA))


def test_the_file_with_two_faces_is_refused_and_has_them(tmp_path: Path) -> None:
    """Readers that begin at the data and readers that begin at the dictionary see other rows in it, and neither complains."""
    file = tmp_path / "faces.parquet"
    file.write_bytes(FACES)
    altered = with_value(TABLE, "time_us", 3, 4242).column("time_us").to_pylist()
    assert pq.read_table(file, page_checksum_verification=True).column("time_us").equals(TABLE.column("time_us"))
    with duckdb.connect() as connection:
        found = connection.execute(f"SELECT time_us FROM '{file}'").fetchall()
    assert [time for (time,) in found] == altered != TABLE.column("time_us").to_pylist()
    with pytest.raises(ValueError, match="column time_us: a dictionary"):
        read(FACES)


def test_the_forger_changes_nothing_but_what_it_means_to() -> None:
    body, footer = footer_of(DATA)
    assert with_footer(body, footer) == DATA
    assert altered_page(DATA, TYPE, 1, lambda header: None) == DATA
    assert read(footed(set_to(6, BINARY, b"somebody else"))(DATA))[2] == rows_of(TABLE)
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


def numbers_in(tree: Tree) -> list[Field]:
    """Every field that is a number, at any depth."""
    found = []
    for each in tree:
        kind, inner = each[1], each[2]
        found += [each] if kind in (I16, I32, I64) else []
        trees = [inner] if kind == STRUCT else inner[1] if kind == LIST and inner[0] == STRUCT else []
        found += [number for one in trees for number in numbers_in(one)]
    return found
