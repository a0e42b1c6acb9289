"""Each way in which a file could say two things to two readers is refused and named."""

import random
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import cast

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import grammar, segment
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.layout import check_layout, read_file, read_layout
from fsar_ledger.ledger.rows.schema import SCHEMA
from tests.ledger.keep_release import LEDGERS
from tests.ledger.layout_changes import CHANGES, Change, about, add
from tests.ledger.parts import Page, Parts, two_faced
from tests.ledger.samples import made_up_run
from tests.ledger.thrift import I32, I64, LIST, STRUCT, Field, Listed, Raw, Struct, field, has, varint
from tests.quick import few

TABLE = encode([made_up_run("run-0", 60, 1), made_up_run("run-1", 60, 2)])
DATA = bytes(segment.to_parquet(TABLE))


def changed(change: Change) -> bytes:
    """Return the segment with one change made to its parts and nothing made to fit."""
    parts = Parts(DATA)
    change(parts)
    return bytes(parts)


def fitted(change: Change) -> bytes:
    """Return the segment with one change, and the sizes and offsets in its footer made to fit."""
    parts = Parts(DATA)
    change(parts)
    return bytes(parts.fit())


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
    if what == "a page that says to unpack to more":  # then only unpacking it shows that
        assert read_layout(fitted(CHANGES[what][0])).rows == 120
    else:
        refusal(fitted(CHANGES[what][0]))


def test_data_pages_before_the_dictionary_of_the_next_column_are_no_hiding_place() -> None:
    """The second face: one page more than the values need, which only a reader that begins elsewhere would meet."""

    def twice(parts: Parts) -> None:
        parts.pages[4].append(Page(list(parts.pages[4][1].header), parts.pages[4][1].body))

    assert "column type: pages of 240 values, expected 120" in refusal(fitted(twice))


# --- how it is said ---


def structs(parts: Parts) -> list[Struct]:
    """Return every struct in the footer and the headers of the first two columns."""
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
    """Write a number in one byte more than it needs."""
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


@pytest.mark.parametrize("way", few(WAYS, ["twice", "in another order"]))
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


@pytest.mark.slow
def test_no_byte_of_the_footer_makes_the_check_fail_otherwise() -> None:
    draw, accepted, good = random.Random(5), 0, read_layout(DATA)
    first = len(DATA) - 8 - int.from_bytes(DATA[-8:-4], "little")
    for _ in range(300):
        at = draw.randrange(first, len(DATA))
        data = DATA[:at] + bytes([draw.randrange(256)]) + DATA[at + 1 :]
        with suppress(LedgerCorrupted):
            accepted += check_layout(Path("file"), data) != good
    assert accepted < 60  # other bounds, histograms, and names of the version


@pytest.mark.slow
def test_no_bit_of_the_order_of_any_column_is_another() -> None:
    orders = b"\x1c\x00\x00" * len(SCHEMA) + b"\x00"
    assert DATA[-8 - len(orders) : -8] == orders
    for at in range(len(DATA) - 8 - len(orders), len(DATA) - 8):
        refusal(DATA[:at] + bytes([DATA[at] ^ 1]) + DATA[at + 1 :])


def test_bytes_behind_the_end_of_the_footer_are_refused() -> None:
    footer_bytes = int.from_bytes(DATA[-8:-4], "little")
    for more in (b"\x00", b"hidden"):
        refusal(DATA[:-8] + more + (footer_bytes + len(more)).to_bytes(4, "little") + DATA[-4:])
