"""Each way in which a file could say two things to two readers is refused, and what is refused is named."""

import random
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import cast

import pyarrow as pa
import pytest

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import grammar, segment
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.layout import check_layout, read_file, read_layout
from fsar_ledger.ledger.rows.schema import SCHEMA
from tests.ledger.keep_release import LEDGERS
from tests.ledger.parts import Page, Parts, two_faced
from tests.ledger.samples import made_up_run
from tests.ledger.thrift import (
    BINARY,
    I32,
    I64,
    LIST,
    STRUCT,
    TRUE,
    Field,
    Listed,
    Raw,
    Struct,
    field,
    has,
    put,
    varint,
)

TABLE = encode([made_up_run("run-0", 60, 1), made_up_run("run-1", 60, 2)])
DATA = bytes(segment.to_parquet(TABLE))
LIST_COLUMN = "achieved.list.element"

Change = Callable[[Parts], object]


def changed(change: Change) -> bytes:
    """The segment with one change made to its parts and nothing made to fit."""
    parts = Parts(DATA)
    change(parts)
    return bytes(parts)


def fitted(change: Change) -> bytes:
    """The segment with one change, and sizes and places in its footer made to fit."""
    parts = Parts(DATA)
    change(parts)
    return bytes(parts.fit())


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


def refusal(data: bytes) -> str:
    with pytest.raises(
        LedgerCorrupted, match=r"^file: the segment cannot be read: found .*; restore the file$"
    ) as caught:
        check_layout(Path("file"), data)
    return str(caught.value)


# --- what is read ---


def test_parts_put_together_unchanged_are_the_segment() -> None:
    assert changed(lambda parts: None) == DATA == fitted(lambda parts: None)


def test_a_layout_tells_rows_columns_writer_and_statistics(tmp_path: Path) -> None:
    found = read_layout(DATA)
    assert (found.rows, found.schema, found.created_by) == (120, SCHEMA, f"parquet-cpp-arrow version {pa.__version__}")
    assert [(said.name, said.least, said.most) for said in found.statistics[:2]] == [
        ("run_id", b"run-0", b"run-1"),
        ("seq", bytes(8), (59).to_bytes(8, "little")),
    ]
    (tmp_path / "file").write_bytes(DATA)
    assert check_layout(tmp_path / "file", read_file(tmp_path / "file")) == found


def test_segments_of_every_kept_release_lie_as_they_should() -> None:
    files = sorted(LEDGERS.glob("*/ledger/segments/*.parquet"))
    assert len(files) >= 3
    for file in files:
        assert check_layout(file, read_file(file)).rows > 0


def test_pages_without_a_dictionary_once_it_is_full_are_read() -> None:
    lists = pa.array([[f"{number:040d}"] for number in range(40_000)], SCHEMA.field("achieved").type)
    table = pa.concat_tables([TABLE] * 400).slice(0, 40_000)
    table = table.set_column(SCHEMA.get_field_index("achieved"), SCHEMA.field("achieved"), lists)
    data = bytes(segment.to_parquet(table))
    encodings = {
        field(cast(Struct, field(page.header, 5)), 2)
        for page in Parts(data).pages[Parts(data).number_of("achieved")][1:]
    }
    assert encodings == {0, 8}
    assert read_layout(data).rows == 40_000


def test_a_long_run_id_is_a_bound_or_none() -> None:
    for size in (127, 128, 4096, 4097):
        data = bytes(segment.to_parquet(encode([made_up_run("x" * size, 9, 1)])))
        assert [said.most for said in read_layout(data).statistics if said.name == "run_id"] == (
            [b"x" * size] if size <= 4096 else []
        )


@pytest.mark.parametrize("name", ["run_id", "seq", "time_us"])
def test_a_column_without_statistics_is_read(name: str) -> None:
    def without(parts: Parts) -> None:
        struct = about(parts, name)
        struct.remove(next(one for one in struct if one.number == 12))

    assert name not in {said.name for said in read_layout(changed(without)).statistics}


def test_numbers_are_as_short_as_they_can_be_and_not_negative() -> None:
    number = re.compile(grammar.ROWS.pattern + b"$", re.DOTALL)
    for value in [*range(300), *(1 << bits for bits in range(34)), (1 << 34) - 1]:
        assert number.fullmatch(grammar.number(value)), value
        assert grammar.DECODED[grammar.number(value)] == value
    for data in (b"\x01", b"\x81\x01", b"\x80\x00", b"\x80\x80\x00", b"", b"\x80", b"\xfe" * 5 + b"\x01"):
        assert not number.fullmatch(data), data


# --- the two faces, and what is hidden ---


def test_a_column_with_two_beginnings_is_refused() -> None:
    other = TABLE.set_column(0, SCHEMA.field(0), pa.array(["other"] * 120))
    forged = two_faced(DATA, bytes(segment.to_parquet(other)), "type")
    assert "column type: pages from byte" in refusal(forged)


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (0, "column run_id: pages from byte"),
        (5, "column achieved: pages from byte"),
        (len(SCHEMA.names), "3 bytes between the last page"),
    ],
)
def test_hidden_bytes_are_refused(number: int, said: str) -> None:
    assert said in refusal(fitted(lambda parts: parts.gaps.update({number: b"abc"})))


def test_hidden_bytes_in_a_chunk_are_refused() -> None:
    number = 4

    def hide(parts: Parts) -> None:
        add(parts.about(number), 7, 3)
        parts.gaps[number + 1] = b"\x15\x00\x15"

    assert "column type: " in refusal(changed(hide))


def test_a_page_that_reaches_into_the_next_column_is_refused() -> None:
    assert "a page that ends at byte" in refusal(changed(lambda parts: add(parts.about(1), 7, -1)))


CHANGES: dict[str, tuple[Change, str]] = {
    "another version of the format": (lambda parts: put(parts.footer, 1, 1), "the footer: "),
    "key-value metadata": (
        lambda parts: put(parts.footer, 5, Listed(STRUCT, [[Field(1, BINARY, b"a")]]), LIST),
        "key-value metadata, expected none",
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
    "a field after the last": (lambda parts: parts.footer.append(Field(20, I32, 1)), "field 20, expected none"),
    "bytes after the footer": (lambda parts: parts.footer.append(Field(7, LIST, Raw(b"\x0c\x00"))), "field 7 twice"),
    "no row group": (lambda parts: put(parts.footer, 4, Listed(STRUCT, [])), "0 row groups, expected 1"),
    "the row group twice": (
        lambda parts: put(parts.footer, 4, Listed(STRUCT, [parts.group()] * 2)),
        "2 row groups, expected 1",
    ),
    "other bytes unpacked in the row group": (lambda parts: add(parts.group(), 2, 1), "bytes unpacked, expected"),
    "other rows in the row group": (lambda parts: add(parts.group(), 3, 1), "a row group of 121 rows, expected 120"),
    "other bytes stored in the row group": (lambda parts: add(parts.group(), 6, 1), "bytes stored, expected"),
    "another place of the row group": (lambda parts: put(parts.group(), 5, 5), "the footer: "),
    "sorted rows": (lambda parts: put(parts.group(), 4, Listed(STRUCT, []), LIST), "a declared order of rows"),
    "a column in another file": (lambda parts: put(parts.chunks()[1], 1, b"x", BINARY), "a column in another file"),
    "a place of metadata": (lambda parts: put(parts.chunks()[1], 2, 4), "the footer: "),
    "a page index": (lambda parts: put(parts.chunks()[1], 4, 4, I64), "an index or a Bloom filter"),
    "a Bloom filter": (lambda parts: put(parts.about(1), 14, 4, I64), "an index or a Bloom filter"),
    "another codec": (lambda parts: put(parts.about(1), 4, 0), "column seq in codec 0, expected 6"),
    "another type": (lambda parts: put(parts.about(1), 1, 1), "expected ('seq', 'INT64')"),
    "another path": (lambda parts: put(parts.about(1), 3, Listed(BINARY, [b"sequence"])), "expected ('seq', 'INT64')"),
    "another encoding of a chunk": (
        lambda parts: put(parts.about(1), 2, Listed(I32, [3, 0])),
        "column seq in encodings [3, 0]",
    ),
    "columns in another order": (
        lambda parts: parts.chunks().insert(1, parts.chunks().pop(2)),
        "column 1 as ('time_us', 'INT64')",
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
    "a count of NULL": (lambda parts: put(statistics(parts, "seq"), 3, 1), "statistics that say 1 NULL of column seq"),
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
        "statistics of column robot",
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
        "key-value metadata of column type",
    ),
    "a page of another kind": (lambda parts: put(header(parts, "seq"), 1, 3), "a page in encoding"),
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
    "a page without a checksum": (lambda parts: header(parts, "seq").pop(3), "without a checksum"),
    "a page of other values": (
        lambda parts: add(data_header(parts, "seq"), 1, 1),
        "column seq: pages of 121 values, expected 120",
    ),
    "a page in another encoding": (lambda parts: put(data_header(parts, "seq"), 2, 0), "a page in encoding 0"),
    "text without its dictionary": (
        lambda parts: put(data_header(parts, "type"), 2, 0),
        "column type: other encodings",
    ),
    "levels in another encoding": (lambda parts: put(data_header(parts, "seq"), 3, 4), "a page in encoding 5"),
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
        "column type: a page in encoding 0",
    ),
    "a dictionary second": (lambda parts: parts.pages[4].reverse(), "column type: a page in encoding"),
    "two dictionaries": (lambda parts: parts.pages[4].insert(1, parts.pages[4][0]), "column type: "),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_is_said_otherwise_than_it_is_is_refused(what: str) -> None:
    change, said = CHANGES[what]
    assert said in refusal(changed(change))


@pytest.mark.parametrize(
    "what",
    [
        "a page that says to unpack to more",
        "a page of other values",
        "two dictionaries",
        "a page without a checksum",
        "a dictionary second",
    ],
)
def test_sizes_that_fit_excuse_nothing(what: str) -> None:
    if what == "a page that says to unpack to more":  # then it is for who unpacks it
        assert read_layout(fitted(CHANGES[what][0])).rows == 120
    else:
        refusal(fitted(CHANGES[what][0]))


def test_data_pages_before_the_dictionary_of_the_next_column_are_no_hiding_place() -> None:
    """The second face: a page more than the values need, which only a reader from another place would meet."""

    def twice(parts: Parts) -> None:
        parts.pages[4].append(Page(list(parts.pages[4][1].header), parts.pages[4][1].body))

    assert "column type: pages of 240 values, expected 120" in refusal(fitted(twice))


# --- how it is said ---


def structs(parts: Parts) -> list[Struct]:
    """Every struct in the footer and the headers of the first two columns."""
    found: list[Struct] = [page.header for pages in parts.pages[:2] for page in pages]
    found += [cast(Struct, one.value) for header in found[:] for one in header if one.kind == STRUCT]
    queue: list[Struct] = [parts.footer]
    while queue and len(found) < 400:
        struct = queue.pop(0)
        found.append(struct)
        for one in struct:
            if one.kind == STRUCT:
                queue.append(cast(Struct, one.value))
            elif one.kind == LIST and cast(Listed, one.value).kind == STRUCT:
                queue += cast("list[Struct]", cast(Listed, one.value).values)[:3]
    return found


def longer(struct: Struct, at: int) -> None:
    """A number in a byte more than it needs."""
    value = cast(int, struct[at].value)
    data = varint(value << 1 if value >= 0 else ~(value << 1))
    struct[at] = struct[at]._replace(value=Raw(data[:-1] + bytes([data[-1] | 0x80]) + b"\0"))


WAYS: dict[str, Callable[[Struct, int], object]] = {
    "missing": lambda struct, at: struct.pop(at),
    "twice": lambda struct, at: struct.insert(at, struct[at]),
    "unknown": lambda struct, at: struct.insert(at + 1, Field(struct[at].number + 40, I32, 1)),
    "in another order": lambda struct, at: (
        struct.append(struct.pop(at)) if at < len(struct) - 1 else struct.insert(0, struct.pop(at))
    ),
    "longer than it need be": longer,
}


@pytest.mark.parametrize("way", WAYS)
def test_a_field_of_any_struct_is_there_once_and_in_its_place(way: str) -> None:
    places = [(number, at) for number, struct in enumerate(structs(Parts(DATA))) for at in range(len(struct))]
    draw, tried = random.Random(way), 0
    while tried < 20:
        number, at = draw.choice(places)
        parts = Parts(DATA)
        one = structs(parts)[number]
        if len(one) == 1 and way == "in another order":
            continue
        if way == "missing" and one[at].number in (12, 16) and has(one, 13):  # statistics, which may be left out
            continue
        if way == "longer than it need be" and one[at].kind not in (I32, I64):
            continue
        WAYS[way](one, at)
        refusal(bytes(parts))
        tried += 1


def test_no_byte_of_the_footer_makes_the_check_fail_otherwise() -> None:
    draw, accepted, good = random.Random(5), 0, read_layout(DATA)
    first = len(DATA) - 8 - int.from_bytes(DATA[-8:-4], "little")
    for _ in range(300):
        at = draw.randrange(first, len(DATA))
        data = DATA[:at] + bytes([draw.randrange(256)]) + DATA[at + 1 :]
        with suppress(LedgerCorrupted):
            accepted += check_layout(Path("file"), data) != good
    assert accepted < 60  # other bounds, histograms, and names of the version
