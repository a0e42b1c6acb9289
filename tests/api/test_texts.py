"""Text made a column at a time is the text that each value alone has, whatever the values are."""

import datetime as dt
from decimal import Decimal
from functools import partial
from typing import Any

import msgspec
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.api.table import Table
from fsar_ledger.api.texts import csv_header, csv_lines, json_bytes, json_lines
from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.base.printable import ascii_json
from fsar_ledger.cli.render import answer_json
from fsar_ledger.metrics.sql_values import plain_rows
from tests.one_by_one import csv_text

TEXT = st.text(alphabet="ab =+-@'\",\\\n\r\t\x00\x1b\x7f\x85\u202e\u0301é\u05d0\u2800\U000e0001xuUn", max_size=6)
NUMBER = st.floats() | st.sampled_from((0.0, -0.0, 1e16, 1e15, 1e-4, 9.9e-5, 5.0))
INTEGER = st.integers(-(2**63), 2**63 - 1)
MOMENT = dt.datetime(2020, 1, 2, 3, 4, 5, 6)
KINDS: tuple[tuple[pa.DataType, st.SearchStrategy[Any]], ...] = (
    (pa.string(), TEXT),
    (pa.float64(), NUMBER),
    (pa.int64(), INTEGER),
    (pa.bool_(), st.booleans()),
    (pa.list_(pa.string()), st.lists(st.none() | TEXT, max_size=3)),
    (pa.list_(pa.float64()), st.lists(st.none() | NUMBER, max_size=3)),
    (pa.list_(pa.int64()), st.lists(st.none() | INTEGER, max_size=3)),
    (pa.list_(pa.list_(pa.string())), st.lists(st.none() | st.lists(TEXT, max_size=2), max_size=2)),
    (pa.date32(), st.just(dt.date(2020, 1, 2))),
    (pa.timestamp("us"), st.just(MOMENT)),
    (pa.timestamp("us", "UTC"), st.just(MOMENT)),
    (pa.duration("us"), st.just(dt.timedelta(seconds=5))),
    (pa.decimal128(10, 2), st.sampled_from((Decimal("1.50"), Decimal(-3)))),
    (pa.decimal128(38, 0), st.sampled_from((Decimal(2**70), Decimal(-3)))),
    (pa.binary(), st.sampled_from((b'\xff"a', b""))),
    (pa.null(), st.none()),
    (pa.struct([("a", pa.string())]), st.fixed_dictionaries({"a": st.none() | TEXT})),
)


@st.composite
def batches(draw: st.DrawFn) -> pa.RecordBatch:
    """Draw rows of some kinds of columns, text always among them, also as a slice of a longer batch."""
    count = draw(st.integers(0, 8))
    kinds = [(pa.string(), TEXT), *draw(st.lists(st.sampled_from(KINDS), max_size=3))]
    columns = [
        pa.array(draw(st.lists(st.none() | values, min_size=count, max_size=count)), kind) for kind, values in kinds
    ]
    names = [f"{at}{draw(st.sampled_from(('', chr(34) + 'é' + chr(10))))}" for at in range(len(columns))]
    return pa.record_batch(columns, names=names).slice(draw(st.integers(0, count)))


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(batches(), st.booleans())
def test_csv_of_columns_is_csv_of_values(batch: pa.RecordBatch, raw: bool) -> None:
    rows, names = plain_rows(pa.Table.from_batches([batch])), batch.schema.names
    assert csv_header(names, raw=raw) + csv_lines(batch, raw=raw) == csv_text(rows, names, raw=raw)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(batches())
def test_json_of_columns_is_json_of_values(batch: pa.RecordBatch) -> None:
    rows = plain_rows(pa.Table.from_batches([batch]))
    if not rows:
        return
    assert json_lines(batch) == "".join(ascii_json(json_bytes(row).decode()) + "\n" for row in rows)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(batches())
def test_each_line_of_ndjson_is_a_row(batch: pa.RecordBatch) -> None:
    rows = msgspec.json.decode(answer_json(None, {"rows": plain_rows(pa.Table.from_batches([batch]))}))["rows"]
    *lines, end = json_lines(batch).split("\n")
    assert end == ""
    assert [msgspec.json.decode(line) for line in lines] == rows
    assert all(line.isascii() and line.isprintable() for line in lines)


def test_a_time_that_python_cannot_hold_is_told_alike_by_rows_and_by_texts() -> None:
    batch = pa.record_batch([pa.array([2**62], pa.timestamp("us"))], names=["at"])
    said = set()
    table = Table(pa.Table.from_batches([batch]))
    for make in (table.rows, partial(json_lines, batch), partial(csv_lines, batch)):
        with pytest.raises(QueryFailed, match="that Python cannot hold, expected years 1 to 9999") as found:
            make()
        said.add(str(found.value))
    assert len(said) == 1
