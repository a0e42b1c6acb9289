"""Rows written in C and in Python are the same bytes, and arrays that do not fit one another are refused."""

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.ledger.rows import Columns, canonical, segment
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.compiled import IS_COMPILED
from fsar_ledger.ledger.rows.schema import COLUMNS, SCHEMA
from fsar_ledger.ledger.verify import verify
from tests.ledger.samples import append_all, contents, made_up_batches, made_up_run

compiled = pytest.mark.skipif(not IS_COMPILED, reason="no compiler was there")

LIMIT = 2**53 - 1
TEXTS = st.text(max_size=8)
VALUES = {
    "string": st.none() | TEXTS,
    "integer": st.none() | st.integers(-LIMIT, LIMIT),
    "boolean": st.none() | st.booleans(),
    "strings": st.none() | st.lists(TEXTS, max_size=3),
}
NAMES = ["run_id", "seq", *(next(name for name, one in COLUMNS.items() if one == kind) for kind in VALUES)]


def rows(names: list[str]) -> st.SearchStrategy[list[dict[str, object]]]:
    given_values = {name: VALUES[COLUMNS[name]] for name in names}
    return st.lists(st.fixed_dictionaries(given_values | {"run_id": TEXTS, "type": TEXTS}), min_size=1, max_size=6)


def joined(table: pa.Table) -> list[bytes]:
    lines = canonical.compiled_lines(Columns(table))
    assert lines is not None
    return lines.splitlines()


@compiled
@given(rows(NAMES))
def test_rows_are_written_alike_in_c_and_in_python(values: list[dict[str, object]]) -> None:
    schema = pa.schema([SCHEMA.field(name).with_nullable(True) for name in dict.fromkeys([*NAMES, "type"])])
    table = pa.Table.from_pylist(values, schema=schema)
    assert joined(table) == canonical.from_table(table)
    assert joined(table.slice(1)) == (canonical.from_table(table.slice(1)) if len(values) > 1 else [])


@compiled
def test_events_of_every_kind_are_written_alike_coded_or_plain() -> None:
    for batch in made_up_batches(3, size=300):
        table = encode(batch)
        assert joined(table) == joined(segment.coded(table)) == canonical.from_table(table)


@compiled
def test_arrays_that_do_not_fit_one_another_are_refused() -> None:
    from fsar_ledger.ledger.rows._codec import write_rows

    there, places, ends, starts = np.ones(2, bool), np.zeros(2, np.int32), np.array([3]), np.array([0, 1, 2])
    good = (b'"a":', there, places, b'"x"\n', ends, None)
    assert write_rows(2, [good]) == b'{"a":"x"}\n{"a":"x"}\n'
    assert write_rows(2, [(*good[:5], starts)]) == b'{"a":["x"]}\n{"a":["x"]}\n'
    assert write_rows(2, []) == b"{}\n{}\n"
    bad: dict[str, dict[int, np.ndarray[Any, Any] | bytes | None]] = {
        "too few rows": {1: there[:1]},
        "too many rows": {1: np.ones(3, bool)},
        "too few values": {2: places[:1]},
        "a place beyond the texts": {2: np.array([0, 1], np.int32)},
        "a negative place": {2: np.array([0, -1], np.int32)},
        "an end beyond the texts": {4: np.array([4])},
        "ends that run backwards": {3: b'"x"\n"y"\n', 4: np.array([7, 3])},
        "no ends": {4: None},
        "too few lists": {5: starts[:2]},
        "lists that begin later": {5: np.array([1, 1, 2])},
        "lists that run backwards": {5: np.array([0, 2, 1])},
        "lists of other values": {5: np.array([0, 1, 3])},
        "lists of integers": {3: None, 5: starts},
    }
    for why, change in bad.items():
        column = tuple(change.get(at, value) for at, value in enumerate(good))
        with pytest.raises(ValueError, match="column 0: arrays that do not fit"):
            pytest.fail(f"{why}: {write_rows(2, [column])!r}")
    with pytest.raises(TypeError):
        write_rows(2, [("a", *good[1:])])


@compiled
def test_a_place_that_no_row_reads_may_be_anything() -> None:
    from fsar_ledger.ledger.rows._codec import write_rows

    there, places = np.array([True, False]), np.array([0, 7], np.int32)
    assert write_rows(2, [(b'"a":', there, places, b'"x"\n', np.array([3]), None)]) == b'{"a":"x"}\n{}\n'


def test_a_ledger_verifies_without_the_compiled_function(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    append_all(tmp_path / "ledger", made_up_batches(2, size=200))
    before = contents(tmp_path / "ledger")
    monkeypatch.setattr(canonical, "codec", None)
    assert canonical.compiled_lines(Columns(SCHEMA.empty_table())) is None
    report = verify(tmp_path / "ledger")
    assert report.ok
    assert contents(tmp_path / "ledger") == before


@pytest.mark.slow
def test_no_cycle_holds_the_columns_of_a_table() -> None:
    """A process that reads segment after segment would hold them until the collector comes by."""
    table = encode([made_up_run("run", 40, 1)])
    canonical.leaves(table)
    gc.collect()
    gc.disable()
    try:
        canonical.leaves(table)
        assert gc.collect() == 0
    finally:
        gc.enable()
