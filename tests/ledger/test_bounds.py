import re
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
import pyarrow as pa
import pytest

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import bounds, segment
from fsar_ledger.ledger.rows.bounds import text_bytes
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.layout import check_layout, read_file
from tests.ledger.agreement import ROOT, independent
from tests.ledger.hostile import lying_pages, packed
from tests.ledger.parts import Parts
from tests.ledger.samples import made_up_run
from tests.ledger.thrift import Struct, field, put

TABLE = encode([made_up_run("run-0", 300, 1)])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "segment.parquet"
    path.write_bytes(bytes(segment.to_parquet(TABLE)))
    return path


def refusal(file: Path, data: bytes | pa.Table, **options: object) -> str:
    file.write_bytes(data if isinstance(data, bytes) else packed(data, **options))
    with pytest.raises(LedgerCorrupted) as caught:
        check_layout(file, read_file(file))
    assert str(caught.value).startswith(f"{file}: ")
    return str(caught.value).removeprefix(f"{file}: ")


def test_a_segment_as_it_is_written_is_within_bounds(file: Path) -> None:
    assert check_layout(file, read_file(file)).rows == 300
    assert segment.read_table(file).equals(TABLE)


@pytest.mark.parametrize(
    "options", [{"compression_level": 9}, {"write_statistics": False}, {"data_page_size": 100, "write_batch_size": 7}]
)
def test_what_other_writers_may_choose_is_read(file: Path, options: Mapping[str, object]) -> None:
    file.write_bytes(packed(TABLE, **options))
    assert file.read_bytes() != bytes(segment.to_parquet(TABLE))
    assert segment.read_table(file).equals(TABLE)


def test_a_file_without_a_whole_footer_is_refused(file: Path) -> None:
    good = file.read_bytes()
    assert "end in b'PARE'" in refusal(file, good[:-1] + b"E")
    assert "expected a Parquet file" in refusal(file, good[:-8] + (len(good) - 11).to_bytes(4, "little") + good[-4:])
    assert "expected a Parquet file" in refusal(file, b"PAR1")
    assert "expected a Parquet file" in refusal(file, b"")
    assert "begin with b'\\x00AR1', expected a Parquet file" in refusal(file, b"\0" + good[1:])


def test_a_footer_longer_than_any_is_refused_unread(file: Path) -> None:
    data = b"PAR1" + bytes((1 << 20) + 1)
    assert "a footer of 1048577 bytes, expected at most 1048576; restore" in refusal(
        file, data + ((1 << 20) + 1).to_bytes(4, "little") + b"PAR1"
    )


def test_a_file_larger_than_any_is_refused_unread(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MAX_SEGMENT_BYTES", file.stat().st_size)
    assert check_layout(file, read_file(file)).rows == 300
    assert "found more than" in refusal(file, b"\0" + file.read_bytes())


def test_row_groups_and_rows_have_bounds(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "the footer: " in refusal(file, TABLE, row_group_size=200)
    assert "found 0 rows" in refusal(file, TABLE.slice(0, 0))
    monkeypatch.setattr(bounds, "MAX_ROWS", 299)
    assert "found 300 rows, expected 1 to 299" in refusal(file, TABLE)


def test_pages_have_bounds(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, least, message in (
        ("MAX_PAGES", 4, "more than 4 pages"),
        ("MAX_UNPACKED_BYTES", 5000, "pages that unpack to"),
        ("MAX_LIST_VALUES", 9, "elements of lists with those before, expected at most 9"),
        ("MAX_BOUND_BYTES", 4, "other statistics of column run_id"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(bounds, name, least)
            assert message in refusal(file, TABLE, data_page_size=100, max_rows_per_page=20)


def test_the_page_and_the_independent_reader_name_the_bounds_of_the_package() -> None:
    reader = independent("independent_parquet")
    own = {name: value for name, value in vars(bounds).items() if name.startswith("MAX_")}
    own["MAX_FILE_BYTES"] = own.pop("MAX_SEGMENT_BYTES")
    shared = sorted(own.keys() & vars(reader).keys())
    assert len(shared) == 8
    assert [getattr(reader, name) for name in shared] == [own[name] for name in shared]
    page = (ROOT / "docs" / "ledger-format.md").read_text("utf-8")
    said = " ".join(page[page.index("**Bounds**") :].partition("\n\n")[0].split())
    named = ("FILE_BYTES", "FOOTER_BYTES", "ROWS", "PAGES", "LIST_VALUES", "UNPACKED_BYTES", "TEXT_BYTES")
    written_as = {f"MAX_{name}": f"2^{own[f'MAX_{name}'].bit_length() - 1}" for name in named} | {"MAX_PAGES": "1,024"}
    assert re.findall(r"2\^\d+|\d,\d+", said) == [written_as[f"MAX_{name}"] for name in named]


def test_a_page_that_says_something_else_than_the_footer_is_refused(file: Path) -> None:
    messages = [refusal(file, data) for _, data in lying_pages(TABLE)]
    assert "pages of 8191 values, expected 300" in messages[0]
    assert "a page header of other fields" in messages[1]


def test_a_dictionary_of_more_values_than_its_bytes_can_hold_is_refused(file: Path) -> None:
    parts = Parts(file.read_bytes())
    header = parts.pages[parts.number_of("run_id")][0].header
    put(cast(Struct, field(header, 7)), 1, cast(int, field(header, 2)) // 4 + 1)
    assert "expected at least 4 bytes each" in refusal(file, bytes(parts.fit()))


def test_text_is_counted_as_if_it_were_written_out() -> None:
    assert text_bytes(TABLE) == text_bytes(segment.coded(TABLE))
    coded = pa.DictionaryArray.from_arrays(pa.array(np.array([0, 0, 1, 0], np.int32)), pa.array(["abc", "é"]))
    assert text_bytes(pa.table({"a": coded, "b": pa.array([1, 2, 3, 4])})) == 11
    assert (
        text_bytes(pa.table({"a": pa.array(["abc", None, "", "é"]), "b": pa.array([["x", "yz"], None, [], ["x"]])}))
        == 9
    )
    assert text_bytes(pa.table({"a": pa.array([], pa.string())})) == 0


def test_more_text_than_a_reader_should_hold_is_refused(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = text_bytes(TABLE)
    monkeypatch.setattr(segment, "MAX_TEXT_BYTES", size)
    assert segment.read_table(file).num_rows == 300
    monkeypatch.setattr(segment, "MAX_TEXT_BYTES", size - 1)
    with pytest.raises(LedgerCorrupted, match=f"found strings of {size} bytes in 300 rows"):
        segment.read_table(file)
