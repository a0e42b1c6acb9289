"""The Parquet reader of the second verifier reads what the library reads, and refuses what says a thing in two ways."""

import random
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.layout import check_layout
from tests.ledger import thrift
from tests.ledger.agreement import independent, odd_run
from tests.ledger.forgery import changed
from tests.ledger.hostile import packed
from tests.ledger.parquet_damage import DAMAGED, in_footer, to
from tests.ledger.parts import Parts, two_faced
from tests.ledger.samples import made_up_run
from tests.ledger.thrift import I32, I64, Field, Listed, Struct

TABLE = encode([made_up_run("a run", 40, 1), odd_run("\u2028", 9, random.Random(2))])
DATA = bytes(segment.to_parquet(TABLE))


def read(data: bytes) -> tuple[int, list[tuple[str, str]], dict[str, list[Any]]]:
    found: tuple[int, list[tuple[str, str]], dict[str, list[Any]]] = independent("independent_parquet").read(data)
    return found


def rows_of(table: pa.Table) -> dict[str, list[Any]]:
    return {name: table.column(name).to_pylist() for name in table.column_names}


def test_it_reads_what_the_library_reads() -> None:
    for data in (DATA, *(file.read_bytes() for file in sorted(Path("tests/ledgers/0.1.0/ledger/segments").glob("*")))):
        table = pq.read_table(pa.BufferReader(data))
        expected = [(column.name, f"{column.type}{'' if column.nullable else ' not null'}") for column in table.schema]
        assert read(data) == (table.num_rows, expected, rows_of(table))


@pytest.mark.parametrize(
    "pages",
    [
        {},
        {"data_page_size": 100},
        {"dictionary_pagesize_limit": 60},
        {"data_page_size": 100, "dictionary_pagesize_limit": 60},
    ],
)
def test_it_reads_pages_of_any_size_and_strings_beyond_a_full_dictionary(pages: dict[str, Any]) -> None:
    data = packed(TABLE, write_batch_size=5, **pages)
    assert read(data)[2] == rows_of(TABLE)
    check_layout(Path("a segment"), data)


@pytest.mark.parametrize(
    "settings",
    [
        {"compression": "none"},
        {"compression": "snappy"},
        {"use_dictionary": False},
        {"use_dictionary": False, "column_encoding": {"run_id": "DELTA_BYTE_ARRAY"}},
        {"column_encoding": {}},
        {"column_encoding": {"seq": "BYTE_STREAM_SPLIT"}},
        {"data_page_version": "2.0"},
        {"version": "1.0"},
        {"write_statistics": True},
        {"write_statistics": ["run_id", "caused_by"]},
        {"write_page_checksum": False},
        {"write_page_index": True},
        {"store_schema": True},
        {"row_group_size": 7},
    ],
)
def test_a_file_written_in_another_way_is_refused_by_both_verifiers(settings: dict[str, Any]) -> None:
    data = packed(TABLE, **settings)
    assert rows_of(pq.read_table(pa.BufferReader(data))) == rows_of(TABLE)
    with pytest.raises(ValueError, match=r"."):
        read(data)
    with pytest.raises(LedgerCorrupted):
        check_layout(Path("a segment"), data)


def test_it_reads_integers_of_any_size_in_differences() -> None:
    draw = random.Random(3)
    numbers = [draw.choice([0, 1 - 2**53, 2**53 - 1, draw.randrange(-(2**40), 2**40), number]) for number in range(300)]
    for count in (1, 2, 32, 33, 128, 129, 300):
        table = TABLE.take([0] * count)
        table = table.set_column(2, TABLE.schema.field("time_us"), pa.array(numbers[:count]))
        assert read(bytes(segment.to_parquet(table)))[2]["time_us"] == numbers[:count]


# --- what must not be ---


CONTENT = (
    "a lie about all strings",
    "a page that unpacks to more",
    "statistics that lie",
    "statistics of a page that lie",
)
"""Those that show when the pages are unpacked."""
OTHER = changed(TABLE, "type", 3, "Forged.v1")
FACES = two_faced(DATA, bytes(segment.to_parquet(OTHER)), "type")


@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_says_a_thing_in_two_ways_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read(DAMAGED[name](DATA))


@pytest.mark.parametrize("name", [name for name in DAMAGED if name not in CONTENT])
def test_the_layout_of_the_package_refuses_the_same(name: str) -> None:
    with pytest.raises(LedgerCorrupted):
        check_layout(Path("a segment"), DAMAGED[name](DATA))


def test_the_file_with_two_faces_is_refused_and_has_them(tmp_path: Path) -> None:
    """Readers that begin at the data and readers that begin at the dictionary see different rows, and neither
    complains."""
    file = tmp_path / "faces.parquet"
    file.write_bytes(FACES)
    assert pq.read_table(file, page_checksum_verification=True).column("type").equals(TABLE.column("type"))
    with duckdb.connect() as connection:
        found = connection.execute(f"SELECT type FROM '{file}'").fetchall()
    assert [kind for (kind,) in found] == OTHER.column("type").to_pylist() != TABLE.column("type").to_pylist()
    with pytest.raises(ValueError, match=r"stored bytes of the row group"):
        read(FACES)


def test_the_forger_changes_nothing_but_what_it_means_to() -> None:
    assert bytes(Parts(DATA)) == bytes(Parts(DATA).fit()) == DATA
    assert read(in_footer(to(6, b"parquet-cpp-arrow version 9.9.9"))(DATA))[2] == rows_of(TABLE)


def test_no_number_of_a_footer_can_be_another() -> None:
    draw = random.Random(4)
    begin = len(DATA) - 8 - int.from_bytes(DATA[-8:-4], "little")
    for _ in range(20):
        footer, _ = thrift.read(DATA, begin)
        struct, at = draw.choice(numbers_in(footer))
        number, kind, value = struct[at]
        assert isinstance(value, int)
        struct[at] = Field(number, kind, value + draw.choice([-1, 1, 7, -(2**31)]))
        end = thrift.write(footer)
        with pytest.raises(ValueError, match=r"."):
            read(DATA[:begin] + end + len(end).to_bytes(4, "little") + b"PAR1")


def numbers_in(struct: Struct) -> list[tuple[Struct, int]]:
    """Return every field that is a number, at any depth: its struct, and its place there."""
    found = []
    for at, one in enumerate(struct):
        found += [(struct, at)] if one.kind in (I32, I64) else []
        inner = one.value.values if isinstance(one.value, Listed) else [one.value]
        found += [number for each in inner if isinstance(each, list) for number in numbers_in(each)]
    return found
