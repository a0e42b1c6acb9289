"""Both verifiers find what a segment says twice when only its rows show it to be false, even if they cannot write the
same bytes again."""

import random
from pathlib import Path
from zlib import crc32

import pyarrow as pa
import pytest

from tests.ledger.agreement import OTHER_VERSION, VERSION, by_package, judged
from tests.ledger.agreement_chain import tables_of
from tests.ledger.agreement_segments import forged_segment, two_faces
from tests.ledger.forgery import segment_at
from tests.ledger.hostile import packed
from tests.ledger.parquet_damage import DAMAGED, TIME, TYPE, lying, to, within, without
from tests.ledger.parts import Page, Parts
from tests.ledger.samples import append_all, made_up_run
from tests.ledger.test_independent_parquet import CONTENT
from tests.ledger.thrift import I64, LIST, STRUCT, Field, Listed, put
from tests.quick import few


@pytest.fixture
def path(tmp_path: Path) -> Path:
    sizes = ((12, 12), (15, 15))
    runs = [
        [made_up_run(f"run-{at}-{one}", size, 10 * at + one) for one, size in enumerate(two)]
        for at, two in enumerate(sizes)
    ]
    append_all(tmp_path / "ledger", runs)
    return tmp_path / "ledger"


@pytest.mark.parametrize("version", [VERSION, OTHER_VERSION])
@pytest.mark.parametrize("name", CONTENT)
def test_both_verifiers_find_what_only_the_rows_show_as_false(path: Path, name: str, version: bytes) -> None:
    data = DAMAGED[name](segment_at(path, 1).read_bytes().replace(VERSION, version))
    case = forged_segment(path, 1, data, name)
    assert judged(case).difference == ""


def test_both_verifiers_find_two_faces(path: Path, tmp_path: Path) -> None:
    case = two_faces(path, random.Random(1), tmp_path)
    assert case is not None
    assert judged(case).difference == ""


@pytest.mark.parametrize("page", few(range(3), [1]))
def test_statistics_of_each_page_are_those_of_its_rows(path: Path, page: int) -> None:
    """Pages of ten rows, by another version of the library; those of integers state their least and greatest value."""
    data = packed(tables_of(path)[1], data_page_size=1, write_batch_size=10).replace(VERSION, OTHER_VERSION)
    parts = Parts(data)
    assert len(parts.pages[TIME]) == 3
    case = forged_segment(path, 1, data, "pages of ten rows")._replace(is_good=True)
    assert judged(case).difference == ""
    within(5, within(5, lying))(parts.pages[TIME][page].header)
    case = forged_segment(path, 1, bytes(parts.fit()), "a page that lies")
    assert judged(case).difference == ""
    found = by_package(case)
    assert found is not None
    assert "statistics" in found[1]


@pytest.mark.parametrize("has_statistics", [True, False])
def test_a_page_without_rows_has_no_statistics(path: Path, has_statistics: bool) -> None:
    parts = Parts(segment_at(path, 1).read_bytes().replace(VERSION, OTHER_VERSION))
    unpacked = b"\x80\x01\x04\x00\x00"  # blocks of 128 integers by 4: none
    stored = bytes(pa.Codec("zstd").compress(unpacked))
    page = Page(Parts(bytes(parts)).pages[TIME][0].header, stored)
    for number, value in ((2, len(unpacked)), (3, len(stored)), (4, (crc32(stored) + 2**31) % 2**32 - 2**31)):
        put(page.header, number, value)
    within(5, to(1, 0))(page.header)
    if not has_statistics:
        within(5, to(5, []))(page.header)
    parts.pages[TIME].append(page)
    within(13, to(3, 2))(parts.about(TIME))
    case = forged_segment(path, 1, bytes(parts.fit()), "a page of nothing")._replace(is_good=not has_statistics)
    assert judged(case).difference == ""


def test_sizes_may_be_left_out_and_say_nothing_of_integers_that_every_row_has(path: Path) -> None:
    parts = Parts(segment_at(path, 1).read_bytes().replace(VERSION, OTHER_VERSION))
    without(16)(parts.about(TYPE))
    nothing = Listed(I64, [])
    put(parts.about(TIME), 16, [Field(2, LIST, nothing), Field(3, LIST, nothing)], STRUCT)
    case = forged_segment(path, 1, bytes(parts), "other sizes")._replace(is_good=True)
    assert judged(case).difference == ""
