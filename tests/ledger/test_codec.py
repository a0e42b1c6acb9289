import json
import re
from contextlib import suppress
from itertools import groupby, product
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import InvalidRun, LedgerCorrupted
from fsar_ledger.events import ALONE, Event
from fsar_ledger.events.envelope import flat, with_columns
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.rows import canonical, schema, segment
from fsar_ledger.ledger.rows.check import first_flaw
from fsar_ledger.ledger.rows.codec import LedgerRun, decode, encode, encode_hashed
from fsar_ledger.ledger.rows.layout import check_layout, read_file
from fsar_ledger.ledger.rows.schema import CODED_SCHEMA, COLUMNS, FINGERPRINT, LAYOUTS, MAX_INTEGER, SCHEMA
from tests.ledger.pinned import ROWS, pinned_row
from tests.ledger.samples import any_event_of, any_runs, made_up_batches, made_up_run

PINNED = ROWS.read_bytes().splitlines()
LAYOUT_LIST = list(LAYOUTS.values())
BY_MODULE = {
    module: list(layouts)
    for module, layouts in groupby(
        LAYOUT_LIST,
        key=lambda layout: layout.tag if layout.cls in ALONE else layout.cls.__module__.rpartition(".")[2],
    )
}
OFTEN = ("request", "execution", "fleet", "ShardRecorded.v1")
"""Modules whose types are tried each time; those of the others with `make test-all`."""


def through_parquet(table: pa.Table, path: Path) -> pa.Table:
    path.write_bytes(segment.to_parquet(table))
    return segment.read_table(path)


@pytest.mark.parametrize(
    "layouts",
    [
        pytest.param(layouts, id=module, marks=[] if module in OFTEN else pytest.mark.slow)
        for module, layouts in BY_MODULE.items()
    ],
)
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_every_event_type_survives_arrow_and_parquet(
    layouts: list[schema.StoredType], data: st.DataObject, tmp_path: Path
) -> None:
    events = [data.draw(any_event_of(layout)) for layout in layouts]
    runs = [LedgerRun("r", list(range(len(events))), [None, *range(len(events) - 1)], events)]
    assert list(decode(through_parquet(encode(runs), tmp_path / "s.parquet"))) == runs


@pytest.mark.slow
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(runs=any_runs())
def test_runs_survive_arrow_and_parquet(runs: list[LedgerRun], tmp_path: Path) -> None:
    assert list(decode(through_parquet(encode(runs), tmp_path / "s.parquet"))) == runs


def rows_as_json(runs: list[LedgerRun]) -> list[bytes]:
    """Return the canonical bytes by a third, slow producer: the standard library."""
    found = []
    for run in runs:
        for seq, event in enumerate(run.events):
            row = flat(event)
            row |= {
                "run_id": run.run_id,
                "seq": seq,
                "time_us": run.times_us[seq],
                "caused_by": run.caused_by[seq],
                "type": type(event).__struct_config__.tag,
            }
            kept = {name: value for name, value in row.items() if value is not None}
            found.append(json.dumps(kept, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode())
    return found


def check_leaves(runs: list[LedgerRun]) -> None:
    leaves = encode_hashed(runs)[1]
    expected = rows_as_json(runs)
    assert canonical.from_table(encode(runs)) == expected
    assert leaves == b"".join(map(merkle.leaf_hash, expected))


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(runs=any_runs())
def test_structs_columns_and_the_standard_library_give_the_same_canonical_bytes(runs: list[LedgerRun]) -> None:
    check_leaves(runs)


def test_canonical_bytes_are_the_same_when_a_type_has_more_rows_than_are_encoded_at_once() -> None:
    runs = [made_up_run(f"run-{seed}", 900, seed) for seed in range(2)]
    first = runs[0].events[0]
    many = [made_up_run("one-type", size, seed=3) for size in (255, 256, 257, 513)]
    check_leaves(
        [
            *runs,
            *(
                msgspec.structs.replace(run, run_id=f"r{len(run.events)}", events=[first] * len(run.events))
                for run in many
            ),
        ]
    )


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(runs=any_runs())
def test_coded_and_plain_strings_are_the_same_rows_and_the_same_segment(runs: list[LedgerRun]) -> None:
    coded, plain = encode_hashed(runs)[0], encode(runs)
    assert coded.schema.equals(CODED_SCHEMA)
    coded.validate(full=True)
    assert segment.coded(plain).equals(coded)
    assert segment.to_parquet(plain).equals(segment.to_parquet(coded))


def test_the_bytes_of_one_row_of_each_type_are_pinned() -> None:
    assert [json.loads(line)["type"] for line in PINNED] == list(LAYOUTS), (
        "run `python -m tests.ledger.pinned`; that changes the format"
    )
    assert [pinned_row(layout) for layout in LAYOUT_LIST] == PINNED


def test_pinned_rows_are_sorted_and_hold_every_column_of_their_type() -> None:
    for line, layout in zip(PINNED, LAYOUT_LIST, strict=True):
        names = list(json.loads(line))
        assert names == sorted(names)
        assert set(names) == {field.name for field in (*schema.ENVELOPE, *layout.fields)}


def test_schema_holds_every_field_of_every_event_type() -> None:
    for layout in LAYOUT_LIST:
        assert {field.name for field in layout.fields} <= set(COLUMNS)
    assert SCHEMA.names[:5] == ["run_id", "seq", "time_us", "caused_by", "type"]
    assert SCHEMA.names[5:] == sorted(SCHEMA.names[5:])


def test_fingerprint_depends_on_names_types_and_nullability() -> None:
    others = [
        SCHEMA.remove(5),
        SCHEMA.set(5, pa.field("another", SCHEMA.field(5).type)),
        SCHEMA.set(5, pa.field(SCHEMA.names[5], pa.float64())),
        SCHEMA.set(5, SCHEMA.field(5).with_nullable(False)),
    ]
    assert len({FINGERPRINT, *map(schema.fingerprint, others)}) == 5


class FloatingEvent(Event, frozen=True):
    share: float


class SeqEvent(Event, frozen=True):
    seq: int


class OtherRobotEvent(Event, frozen=True):
    robot: int


def test_event_types_that_a_ledger_cannot_hold_are_refused() -> None:
    with pytest.raises(
        TypeError, match=r"^Floating.*: field \w+: found float, expected str, .* integer of a smaller unit"
    ):
        schema.stored_type(FloatingEvent)
    with pytest.raises(TypeError, match="envelope column"):
        schema.stored_type(SeqEvent)
    with pytest.raises(TypeError, match="field robot is integer"):
        schema.columns((*LAYOUT_LIST, schema.stored_type(OtherRobotEvent)))


def test_encode_refuses_what_could_not_be_verified() -> None:
    run = made_up_run("run", 4, seed=1)
    for changed in (
        msgspec.structs.replace(run, times_us=[0]),
        msgspec.structs.replace(run, events=[], times_us=[], caused_by=[]),
        msgspec.structs.replace(run, caused_by=[None, 0, 2, 0]),
        msgspec.structs.replace(run, caused_by=[0, 0, 0, 0]),
        msgspec.structs.replace(run, caused_by=[-1, 0, 0, 0]),
        msgspec.structs.replace(run, caused_by=[None, 0, 0, -1]),
        msgspec.structs.replace(run, times_us=[0, 1, 2, MAX_INTEGER + 1]),
        msgspec.structs.replace(run, times_us=[0, 1, 2, None]),
    ):
        with pytest.raises(ValueError, match="expected"):
            encode([changed])


def test_encode_refuses_none_in_a_field_that_must_have_a_value() -> None:
    layout = next(
        layout
        for layout in LAYOUT_LIST
        if any(not field.is_nullable and field.kind == "string" and field.values is None for field in layout.fields)
    )
    event = layout.event([None for _ in layout.fields])
    with pytest.raises(ValueError, match="expected a value"):
        encode([LedgerRun("run", [0], [None], [event])])


def run_with(kind: str, value: object) -> LedgerRun:
    """Return a run of one event that is valid except for its fields of this kind."""
    layout = next(
        layout for layout in LAYOUT_LIST if any(field.kind == kind and field.values is None for field in layout.fields)
    )
    event = next(
        event for seed in range(99) for event in made_up_run("run", 400, seed).events if type(event) is layout.cls
    )
    fields: dict[str, Any] = {field.name: value for field in layout.fields if field.kind == kind}
    return LedgerRun("run", [0], [None], [with_columns(event, **fields)])


@pytest.mark.parametrize("value", [MAX_INTEGER + 1, -MAX_INTEGER - 1])
def test_encode_refuses_integers_that_json_readers_round(value: int) -> None:
    with pytest.raises(ValueError, match=r"expected at most 2\^53 - 1"):
        encode([run_with("integer", value)])


@pytest.mark.parametrize(
    ("kind", "value"),
    [("string", 1), ("string", b"text"), ("string", ("a",)), ("integer", "1"), ("boolean", 1), ("strings", (1,))],
)
def test_encode_refuses_values_of_another_type(kind: str, value: object) -> None:
    with pytest.raises((TypeError, ValueError)):
        encode([run_with(kind, value)])


def test_encode_refuses_text_that_is_not_unicode() -> None:
    with pytest.raises(InvalidRun, match=r"seq 0, field \w+: found .*ud800"):
        encode([run_with("string", "\ud800")])


def table_with(name: str, row: int, value: object, kind: pa.DataType | None = None) -> pa.Table:
    """Return a table that is valid except for one value."""
    table = encode(made_up_batches(1, runs=2, size=400)[0])
    values = table.column(name).to_pylist()
    values[row] = value
    field = SCHEMA.field(name)
    at = SCHEMA.get_field_index(name)
    return table.set_column(
        at,
        field if kind is None else pa.field(name, kind, nullable=field.nullable),
        pa.array(values, kind or field.type),
    )


def row_of(condition: Any) -> int:
    """Return the first row of that table whose layout fits."""
    events = [event for run in made_up_batches(1, runs=2, size=400)[0] for event in run.events]
    return next(
        row
        for row, event in enumerate(events)
        if row > 2
        and condition({field.name: field for field in LAYOUTS[str(type(event).__struct_config__.tag)].fields})
    )


def flaw_of(table: pa.Table) -> tuple[int, str | None]:
    flaw = first_flaw(table)
    assert flaw is not None
    with pytest.raises(LedgerCorrupted, match="expected"):
        list(decode(table))
    if flaw.row >= 0:
        assert (flaw.run, flaw.seq) == (table.column("run_id")[flaw.row].as_py(), table.column("seq")[flaw.row].as_py())
    return flaw.row, flaw.field


def test_valid_rows_have_no_flaw() -> None:
    assert first_flaw(encode(made_up_batches(1, runs=2, size=400)[0])) is None
    assert first_flaw(SCHEMA.empty_table()) is None
    assert list(decode(SCHEMA.empty_table())) == []


def test_wrong_columns_are_refused() -> None:
    table = encode(made_up_batches(1)[0])
    assert flaw_of(table.drop_columns(["robot"])) == (-1, None)
    assert flaw_of(table.append_column("more", pa.nulls(table.num_rows))) == (-1, None)
    assert flaw_of(table_with("time_us", 0, 1.5, pa.float64())) == (-1, None)


def test_envelope_flaws_are_named() -> None:
    assert flaw_of(table_with("seq", 5, 6)) == (5, "seq")
    assert flaw_of(table_with("seq", 0, 1)) == (0, "seq")
    assert flaw_of(table_with("caused_by", 5, 5)) == (5, "caused_by")
    assert flaw_of(table_with("caused_by", 5, -1)) == (5, "caused_by")
    assert first_flaw(table_with("caused_by", 5, None)) is None  # what led to it is not known
    assert flaw_of(table_with("caused_by", 400, 0)) == (400, "caused_by")
    assert flaw_of(table_with("time_us", 5, 2**53)) == (5, "time_us")
    assert flaw_of(table_with("time_us", 5, -(2**53))) == (5, "time_us")
    assert flaw_of(table_with("time_us", 5, None))[1] in {"time_us", None}


def test_a_run_in_two_blocks_is_refused() -> None:
    first, second, third = (encode([made_up_run(name, 3, seed=1)]) for name in ("a", "b", "a"))
    assert flaw_of(pa.concat_tables([first, second, third])) == (6, "run_id")


@pytest.mark.parametrize(
    ("name", "condition", "value"),
    [
        ("task_id", lambda fields: "task_id" in fields and not fields["task_id"].is_nullable, None),
        ("task_id", lambda fields: "task_id" not in fields, "t1"),
        ("outcome", lambda fields: "outcome" in fields, "perhaps"),
    ],
    ids=["missing", "of a field that the type lacks", "not allowed"],
)
def test_a_value_that_cannot_be_there_is_named(name: str, condition: Any, value: str | None) -> None:
    row = row_of(condition)
    assert flaw_of(table_with(name, row, value)) == (row, name)


def test_the_earliest_flaw_is_the_one_named() -> None:
    table = table_with("time_us", 300, 2**60)
    at = SCHEMA.get_field_index("seq")
    seqs = table.column("seq").to_pylist()
    seqs[200] = 0
    assert flaw_of(table.set_column(at, SCHEMA.field("seq"), pa.array(seqs, pa.int64()))) == (200, "seq")


def test_text_that_is_not_utf8_is_a_flaw() -> None:
    table = encode(made_up_batches(1)[0])
    broken = pa.array([b"\xff"] * table.num_rows, pa.binary()).view(pa.string())
    assert flaw_of(table.set_column(0, SCHEMA.field("run_id"), broken)) == (-1, None)


def test_a_segment_is_the_same_bytes_every_time_and_plain_parquet(tmp_path: Path) -> None:
    runs = made_up_batches(1, runs=3, size=200)[0]
    one, two = (bytes(segment.to_parquet(encode(runs))) for _ in range(2))
    assert one == two
    (tmp_path / "s.parquet").write_bytes(one)
    metadata = pq.read_metadata(tmp_path / "s.parquet")
    assert metadata.num_row_groups == 1
    columns = [metadata.row_group(0).column(at) for at in range(metadata.num_columns)]
    assert {column.compression for column in columns} == {"ZSTD"}
    for column, kind in zip(columns, COLUMNS.values(), strict=True):
        assert column.has_dictionary_page == (kind in ("string", "strings"))
        assert ("DELTA_BINARY_PACKED" in column.encodings) == (kind == "integer")
    assert pq.ParquetFile(tmp_path / "s.parquet").schema_arrow.equals(SCHEMA)


@pytest.mark.parametrize("how", ["a column less", "a column more"])
def test_a_segment_of_other_columns_is_refused(tmp_path: Path, how: str) -> None:
    table = encode(made_up_batches(1)[0])
    more = table.append_column("more", pa.nulls(table.num_rows, pa.int64()))
    other = table.drop_columns(["robot"]) if how == "a column less" else more
    pq.write_table(other, tmp_path / "other.parquet", store_schema=False)
    with pytest.raises(LedgerCorrupted, match="found the footer: other fields or values, expected"):
        segment.read_table(tmp_path / "other.parquet")


def test_pages_that_are_laid_out_well_and_cannot_be_decoded_are_refused(tmp_path: Path) -> None:
    """The header of a dictionary counts texts that are not there, which only the decoder sees."""
    file, good = tmp_path / "s.parquet", bytes(segment.to_parquet(encode(made_up_batches(1)[0])))
    column = pq.read_metadata(pa.BufferReader(good)).row_group(0).column(SCHEMA.get_field_index("run_id"))
    begin, said = column.dictionary_page_offset, []
    for at, bit in product(range(begin, begin + 24), range(8)):
        file.write_bytes(good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :])
        with suppress(LedgerCorrupted):
            check_layout(file, read_file(file))
            with pytest.raises(LedgerCorrupted) as caught:
                segment.read_table(file)
            said.append(str(caught.value))
    assert said
    for line in said:
        assert re.fullmatch(
            f"{re.escape(str(file))}: the segment cannot be read \\(.+\\); expected a Parquet file with valid page "
            "checksums; restore it",
            line,
        )
