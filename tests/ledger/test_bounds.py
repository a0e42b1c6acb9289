from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger import bounds, segment
from fsar_ledger.ledger.bounds import check_bounds, text_bytes
from fsar_ledger.ledger.codec import encode
from fsar_ledger.ledger.footer import Column
from tests.ledger.hostile import lying_pages, written
from tests.ledger.samples import made_up_run

TABLE = encode([made_up_run("run-0", 300, 1)])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "segment.parquet"
    path.write_bytes(bytes(segment.to_parquet(TABLE)))
    return path


def refusal(file: Path, data: bytes | pa.Table, **options: object) -> str:
    file.write_bytes(data if isinstance(data, bytes) else written(data, **options))
    with pytest.raises(LedgerCorrupted) as caught:
        check_bounds(file)
    assert str(caught.value).startswith(f"{file}: ")
    return str(caught.value).removeprefix(f"{file}: ")


def test_a_segment_as_it_is_written_is_within_bounds(file: Path) -> None:
    assert check_bounds(file).metadata.num_rows == 300
    assert segment.read_table(file).equals(TABLE)


@pytest.mark.parametrize("options", [{"data_page_version": "2.0"}, {"compression": "none"}, {"use_dictionary": False}, {"data_page_size": 100}])
def test_pages_of_other_writers_are_within_bounds(file: Path, options: Mapping[str, object]) -> None:
    file.write_bytes(written(TABLE, **options))
    assert segment.read_table(file).equals(TABLE)


def test_a_file_without_a_whole_footer_is_refused(file: Path) -> None:
    good = file.read_bytes()
    assert "end in b'PARE'" in refusal(file, good[:-1] + b"E")
    assert "expected a Parquet file" in refusal(file, good[:-8] + (len(good) - 11).to_bytes(4, "little") + good[-4:])
    assert "expected a Parquet file" in refusal(file, b"PAR1")
    assert "expected a Parquet file" in refusal(file, b"")


def test_a_footer_longer_than_any_is_refused_unread(file: Path) -> None:
    table = pa.table({"a": [1]}).replace_schema_metadata({"note": "x" * (1 << 20)})
    assert "expected at most 1048576; restore" in refusal(file, table, store_schema=True)


def test_a_file_larger_than_any_is_refused_unread(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MAX_SEGMENT_BYTES", file.stat().st_size)
    assert check_bounds(file).metadata.num_rows == 300
    assert "expected a Parquet file" in refusal(file, b"\0" + file.read_bytes())


def test_row_groups_and_rows_have_bounds(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "found 2 row groups" in refusal(file, TABLE, row_group_size=200)
    assert "found 0 rows" in refusal(file, TABLE.slice(0, 0))
    monkeypatch.setattr(bounds, "MAX_ROWS", 299)
    assert "found 300 rows, expected 1 to 299" in refusal(file, TABLE)


def test_pages_have_bounds(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, least, message in (
        ("_MAX_PAGES", 4, "more than 4 pages"),
        ("MAX_UNPACKED_BYTES", 5000, "pages that unpack to"),
        ("MAX_LIST_VALUES", 100, "pages of "),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(bounds, name, least)
            assert message in refusal(file, TABLE, data_page_size=100, max_rows_per_page=20)


def test_front_coded_strings_are_refused(file: Path) -> None:
    assert "a page in encoding 7" in refusal(file, TABLE, use_dictionary=False, column_encoding={"run_id": "DELTA_BYTE_ARRAY"})


def test_a_page_that_says_something_else_than_the_footer_is_refused(file: Path) -> None:
    messages = [refusal(file, data) for _, data in lying_pages(TABLE)]
    assert "pages of 8191 values, expected at most 300" in messages[0]
    assert "expected a count" in messages[1]


def test_a_dictionary_of_more_values_than_its_bytes_can_hold_is_refused(file: Path) -> None:
    file.write_bytes(written(pa.table({"a": list("abcdefghij")})))
    offset = pq.read_metadata(file).row_group(0).column(0).dictionary_page_offset
    at = file.read_bytes().index(b"\x15\x14", offset)  # a field that holds 10
    assert check_bounds(file).columns[0].path == "a"
    data = file.read_bytes()
    assert "a dictionary of 60 values in 50 bytes" in refusal(file, data[: at + 1] + b"\x78" + data[at + 2 :])


@pytest.mark.parametrize(("at", "stored"), [(0, 10), (4, 997), (1001, 0)])
def test_pages_outside_the_file_are_refused_unread(tmp_path: Path, at: int, stored: int) -> None:
    (tmp_path / "file").write_bytes(bytes(1000))
    column = Column("a", "INT64", at, stored, None, (), (), has_index=False)
    with (tmp_path / "file").open("rb") as opened, pytest.raises(ValueError, match="pages from byte"):
        bounds._check_column(opened, 1000, column, 10, 0)


def test_a_page_that_ends_beyond_its_column_is_refused(file: Path) -> None:
    size, column = file.stat().st_size, check_bounds(file).columns[0]
    shorter = msgspec.structs.replace(column, stored_bytes=column.stored_bytes - 1)
    with file.open("rb") as opened:
        assert bounds._check_column(opened, size, column, 300, 0) > 0
        with pytest.raises(ValueError, match="a page that ends at byte"):
            bounds._check_column(opened, size, shorter, 300, 0)


def test_no_byte_of_the_headers_of_pages_makes_the_check_fail_otherwise(file: Path) -> None:
    good = file.read_bytes()
    column = pq.read_metadata(file).row_group(0).column(0)
    refused = 0
    for at in range(column.dictionary_page_offset or column.data_page_offset, column.data_page_offset + 30):
        for value in (0, 0x19, 0xFF):
            file.write_bytes(good[:at] + bytes([value]) + good[at + 1 :])
            try:
                check_bounds(file)
            except LedgerCorrupted:
                refused += 1
    assert refused > 30


def test_text_is_counted_as_if_it_were_written_out() -> None:
    assert text_bytes(TABLE) == text_bytes(segment.coded(TABLE))
    coded = pa.DictionaryArray.from_arrays(pa.array(np.array([0, 0, 1, 0], np.int32)), pa.array(["abc", "é"]))
    assert text_bytes(pa.table({"a": coded, "b": pa.array([1, 2, 3, 4])})) == 11
    assert text_bytes(pa.table({"a": pa.array(["abc", None, "", "é"]), "b": pa.array([["x", "yz"], None, [], ["x"]])})) == 9
    assert text_bytes(pa.table({"a": pa.array([], pa.string())})) == 0


def test_more_text_than_a_reader_should_hold_is_refused(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = text_bytes(TABLE)
    monkeypatch.setattr(segment, "MAX_TEXT_BYTES", size)
    assert segment.read_table(file).num_rows == 300
    monkeypatch.setattr(segment, "MAX_TEXT_BYTES", size - 1)
    with pytest.raises(LedgerCorrupted, match=f"found strings of {size} bytes in 300 rows"):
        segment.read_table(file)
