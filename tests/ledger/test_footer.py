"""Messages about a refused footer or page name the first fault that a person can act upon."""

from collections.abc import Callable
from typing import cast

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.footer import explain_footer, explain_page, read_struct
from fsar_ledger.ledger.rows.schema import SCHEMA
from tests.ledger import thrift
from tests.ledger.hostile import written
from tests.ledger.parts import Parts
from tests.ledger.samples import made_up_run
from tests.ledger.thrift import BINARY, I32, I64, LIST, STRUCT, TRUE, Field, Listed, Raw, put

TABLE = encode([made_up_run("run-0", 40, 1)])
DATA = bytes(segment.to_parquet(TABLE))


def explained(change: Callable[[Parts], object]) -> str:
    """Return what is said of the footer of a segment with this change."""
    parts = Parts(DATA)
    change(parts)
    return explain_footer(thrift.write(parts.footer), SCHEMA)


def of(table: pa.Table, **options: object) -> str:
    """Return what is said of the footer of this table as some Parquet file."""
    data = written(table, **options)
    return explain_footer(data[len(data) - 8 - int.from_bytes(data[-8:-4], "little") : -8], SCHEMA)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda parts: put(parts.footer, 5, Listed(STRUCT, []), LIST), "key-value metadata, expected none"),
        (lambda parts: put(parts.footer, 8, [Field(1, STRUCT, [])], STRUCT), "an encryption, expected none"),
        (lambda parts: put(parts.footer, 40, 7, I32), "field 40, expected none"),
        (lambda parts: parts.footer.append(Field(1, I32, 2)), "field 1 twice in one struct"),
        (lambda parts: put(parts.footer, 1, Raw(b"\x84\x00")), "a number written longer than it need be"),
        (lambda parts: put(parts.footer, 1, Raw(b"\x80" * 11)), "a number of more than 64 bits"),
        (lambda parts: put(parts.footer, 4, 1, I32), "1 as field 4, expected a list"),
        (lambda parts: put(parts.group(), 4, Listed(STRUCT, []), LIST), "a declared order of rows"),
        (lambda parts: put(parts.group(), 7, 0, I32), "field 7, expected none"),
        (lambda parts: put(parts.chunks()[1], 1, b"other", BINARY), "a column in another file of column seq"),
        (lambda parts: put(parts.chunks()[2], 8, [], STRUCT), "a column that is encrypted of column time_us"),
        (lambda parts: put(parts.chunks()[3], 4, 8, I64), "an index or a Bloom filter of column caused_by"),
        (lambda parts: put(parts.chunks()[3], 3, 8, I32), "8, expected a struct"),
        (lambda parts: put(parts.about(3), 14, 8, I64), "an index or a Bloom filter of column caused_by"),
        (lambda parts: put(parts.about(3), 8, Listed(STRUCT, []), LIST), "key-value metadata of column caused_by"),
        (lambda parts: put(parts.about(3), 10, 8, I64), "an index page of column caused_by"),
        (
            lambda parts: put(parts.about(3), 1, 3),
            "column 3 as ('caused_by', 'INT96'), expected ('caused_by', 'INT64')",
        ),
        (
            lambda parts: put(parts.about(3), 1, 9),
            "column 3 as ('caused_by', 'type 9'), expected ('caused_by', 'INT64')",
        ),
        (lambda parts: put(parts.about(3), 3, Listed(I32, [3])), "3, expected a name"),
        (lambda parts: put(parts.about(3), 4, 1), "column caused_by in codec 1, expected 6"),
        (lambda parts: put(parts.about(3), 5, -1), "-1 as field 5, expected a count"),
        (
            lambda parts: put(parts.about(3), 12, [Field(3, I64, 0)], STRUCT),
            "statistics of column caused_by, expected none but of run_id, seq, time_us",
        ),
        (
            lambda parts: put(cast(thrift.Struct, thrift.field(parts.about(1), 12)), 3, 5),
            "statistics that say 5 NULL of column seq",
        ),
        (
            lambda parts: parts.chunks().pop(),
            f"column {len(SCHEMA.names) - 1} as None, expected ('window', 'BYTE_ARRAY')",
        ),
        (lambda parts: parts.about(1).reverse(), "fields in another order"),
    ],
)
def test_the_fault_of_a_footer_is_named(change: Callable[[Parts], object], said: str) -> None:
    assert said in explained(change)


def test_a_footer_of_a_table_that_is_none_of_ours_is_explained() -> None:
    assert "2 row groups, expected 1" in of(TABLE, row_group_size=20)
    assert "('robots', 'BYTE_ARRAY'), expected ('robot', 'BYTE_ARRAY')" in of(
        TABLE.rename_columns([{"robot": "robots"}.get(name, name) for name in SCHEMA.names])
    )
    assert "a declared order of rows" in of(TABLE, sorting_columns=[pq.SortingColumn(0)], write_statistics=False)


def test_half_a_footer_and_more_than_one_are_told_apart() -> None:
    footer = thrift.write(Parts(DATA).footer)
    assert explain_footer(footer[:-1], SCHEMA) == "the footer: half of it, expected all"
    assert explain_footer(footer + b"xy", SCHEMA) == "the footer: 2 bytes after its end, expected none"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda header: put(header, 2, -1), "-1 as field 2, expected a count"),
        (lambda header: header.pop(), "a page of kind 0, expected data"),
        (lambda header: put(header, 8, [], STRUCT), "a page of kind 0, expected data"),
        (lambda header: put(cast(thrift.Struct, thrift.field(header, 5)), 1, -3), "-3 as field 1, expected a count"),
        (lambda header: put(cast(thrift.Struct, thrift.field(header, 5)), 2, 7), "a page in encoding 7"),
        (lambda header: header.remove(next(field for field in header if field.number == 4)), "without a checksum"),
        (lambda header: put(header, 5, 1, I32), "1, expected a struct"),
    ],
)
def test_the_fault_of_a_page_is_named(change: Callable[[thrift.Struct], object], said: str) -> None:
    header = Parts(DATA).pages[1][0].header
    change(header)
    assert said in explain_page(b"xyz" + thrift.write(header), 3)


def test_half_a_page_header_is_said_to_be_half_of_one() -> None:
    assert (
        explain_page(thrift.write(Parts(DATA).pages[1][0].header)[:-1], 0)
        == "half a page header at byte 0, expected all of it"
    )


@pytest.mark.parametrize("depth", [8, 9])
def test_structs_in_each_other_have_a_bound(depth: int) -> None:
    inner: thrift.Struct = []
    for _ in range(depth):
        inner = [Field(5, STRUCT, inner)]
    assert ("more than 8 structs" if depth > 8 else "key-value metadata, expected none") in explain_footer(
        thrift.write(inner), SCHEMA
    )
    listed: thrift.Value = Listed(I32, [])
    for _ in range(depth - 1):
        listed = Listed(LIST, [listed])
    assert ("more than 8 structs" in explain_footer(thrift.write([Field(1, LIST, listed)]), SCHEMA)) == (depth > 8)


def test_bytes_and_lists_longer_than_what_is_left_are_refused() -> None:
    with pytest.raises(ValueError, match="100 bytes, expected at most the 2 that are left"):
        read_struct(b"\x18\x64x\x00", 0)
    with pytest.raises(ValueError, match="a list of 100, expected at most the 2 bytes that are left"):
        read_struct(b"\x19\xf5\x64\x02\x00", 0)
    with pytest.raises(ValueError, match="a field of type 7"):
        read_struct(b"\x17\x00", 0)
    assert read_struct(thrift.write([Field(1, TRUE, 1), Field(40, TRUE, 0), Field(41, thrift.BYTE, 9)]), 0)[0] == {
        1: 1,
        40: 0,
        41: 9,
    }
