"""Events are written as the same rows in C and in Python, or not in C at all."""

import json
import re
import sys
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.base.errors import InvalidRun
from fsar_ledger.events import CONCERN_OF
from fsar_ledger.events.envelope import with_columns
from fsar_ledger.ledger.rows import compiled
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_lines
from fsar_ledger.ledger.rows.compiled import IS_COMPILED, MARK_OF, OPENING, marks_of, plain_lines
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.rows.schema import LAYOUTS
from fsar_ledger.ledger.store.staging import rows_of
from tests.ledger.samples import IN_RUNS, any_runs, made_up_batches, made_up_run, run_of_every_type
from tests.ledger.test_writer_property import batches, with_event

in_c = pytest.mark.skipif(not IS_COMPILED, reason="no compiler was there")


def is_plain(rows: bytes) -> bool:
    """Return whether all text in these rows is printable ASCII."""
    return rows.replace(b"\n", b"").isascii() and not any(
        re.search(r"[^ -~]", text) for row in rows.splitlines() for text in texts_in(json.loads(row))
    )


def texts_in(value: object) -> Iterator[str]:
    """Yield every text in this JSON, keys left out."""
    if isinstance(value, str):
        yield value
    for one in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from texts_in(one)


def in_python(run: LedgerRun) -> tuple[bytes, int]:
    return b"\n".join((*encode_lines([run]), b"")), marks_of(run)


@in_c
@pytest.mark.parametrize("seed", range(5))
def test_plain_events_of_every_type_are_written_in_c_as_in_python(seed: int) -> None:
    run = run_of_every_type("run-1", seed)
    assert {type(event) for event in run.events} == {layout.cls for layout in IN_RUNS.values()}
    assert plain_lines(run) == in_python(run)


@in_c
def test_a_part_of_a_run_is_written_in_c_as_in_python() -> None:
    run = made_up_run("run-1", 200, 1)
    for first in (0, 1, 7, 199):
        part = piece(run, first, first + 40)
        assert plain_lines(part) == in_python(part)


@in_c
@given(any_runs())
def test_any_events_are_written_in_c_as_in_python_or_not_at_all(runs: list[LedgerRun]) -> None:
    for run in runs:
        expected = in_python(run)
        assert plain_lines(run) == (expected if is_plain(expected[0]) else None)


@in_c
@given(batches())
def test_what_no_row_can_hold_is_not_written_in_c(runs: list[LedgerRun]) -> None:
    for run in runs:
        try:
            expected = in_python(run)
        except InvalidRun:
            assert not run.events or plain_lines(run) is None
        else:
            assert plain_lines(run) in (None, expected)


@in_c
@pytest.mark.parametrize("text", ["\x1f", "\n", "\x7f", "é", "東", "\u2028", "\ud800"])
def test_text_that_is_not_plain_is_left_to_python(text: str) -> None:
    run = made_up_run("run-1", 8, 1)
    seq, name = next(
        (seq, field.name)
        for seq, event in enumerate(run.events)
        for field in LAYOUTS[str(event.__struct_config__.tag)].fields
        if field.kind == "string" and field.values is None
    )
    assert plain_lines(run) is not None
    assert plain_lines(with_event(run, seq, with_columns(run.events[seq], **{name: text}))) is None
    assert plain_lines(LedgerRun(text, run.times_us, run.caused_by, run.events)) is None


@in_c
@pytest.mark.parametrize("changed", [{"times_us": [0]}, {"caused_by": [None]}, {"events": []}, {"events": [None] * 8}])
def test_a_run_that_does_not_hold_together_is_left_to_python(changed: dict[str, Any]) -> None:
    run = made_up_run("run-1", 8, 1)
    parts: dict[str, Any] = {
        "times_us": run.times_us,
        "caused_by": run.caused_by,
        "events": run.events,
        "first": 0,
    } | changed
    assert plain_lines(LedgerRun("run-1", **parts)) is None


@in_c
def test_a_call_with_other_things_is_an_error() -> None:
    from fsar_ledger.ledger.rows._codec import event_types, write_events

    run = made_up_run("run-1", 2, 1)
    given_lists = (list(run.times_us), list(run.caused_by), list(run.events))
    kind = type(run.events[0])
    assert write_events(event_types({}), "run-1", 0, *given_lists) is None
    made: tuple[Any, ...] = (
        [],
        {kind: []},
        {kind: ()},
        {kind: (0, [])},
        {kind: ("no marks", ())},
        {kind: (0, (1,))},
        {kind: (0, ((1, 2),))},
        {kind: (0, ((0, "name", None, None, "x", False, None),))},
    )
    for wrong in made:
        with pytest.raises(TypeError):
            event_types(wrong)
    with pytest.raises(TypeError):
        write_events(event_types({}), "run-1", 0, tuple(run.times_us), *given_lists[1:])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="PyCapsule"):
        write_events({}, "run-1", 0, *given_lists)


class Plain:
    """No struct, so where it keeps what it has is not known."""

    def __init__(self, name: str) -> None:
        self.name = name


class Refuses(msgspec.Struct, frozen=True):
    """A struct that cannot be made of anything, so where it keeps its field is not seen."""

    name: str

    def __post_init__(self) -> None:
        if type(self.name) is not str:
            raise ValueError


class Larger(Refuses, frozen=True, weakref=True):
    """A struct whose objects hold more than their fields."""


@in_c
@pytest.mark.parametrize("kind", [Plain, Refuses, Larger])
def test_a_field_is_read_by_its_name_where_its_place_is_not_known(kind: type[Any]) -> None:
    from fsar_ledger.ledger.rows._codec import event_types, write_events

    made = event_types({kind: (4, ((0, b'"x":', "name", None, "name", False, None),))})
    assert write_events(made, "run-1", 7, [0, 0], [0, 0], [kind("a"), kind("b")]) == (b'{"x":"a"}\n{"x":"b"}\n', 4)


@pytest.mark.parametrize("seed", range(3))
def test_the_marks_of_a_run_are_those_of_its_events_but_the_one_that_begins_it(seed: int) -> None:
    run = made_up_run("run-1", 40, seed)
    for first, end in ((0, 1), (0, 40), (3, 4), (3, 40)):
        part = piece(run, first, end)
        marks = marks_of(part)
        assert not marks & OPENING
        assert {concern for concern, mark in MARK_OF.items() if marks & mark} == {
            CONCERN_OF[name] for event in part.events if (name := type(event).__name__) in CONCERN_OF
        }
    assert marks_of(LedgerRun("run-1", [0, 0], [None, 0], [run.events[0], run.events[0]])) & OPENING


@in_c
def test_writing_rows_keeps_nothing() -> None:
    run, odd = (made_up_run("run-1", 30, seed) for seed in (1, 2))
    odd = msgspec.structs.replace(odd, run_id="é")
    held = [run.run_id, odd.run_id, *run.events, *odd.events]
    before = list(map(sys.getrefcount, held))
    for _ in range(50):
        assert plain_lines(run) is not None
        assert plain_lines(odd) is None
    assert list(map(sys.getrefcount, held)) == before
    nothing = sys.getrefcount(None)
    for _ in range(1_000):
        plain_lines(odd)
    assert sys.getrefcount(None) < nothing + 500


def test_rows_are_the_same_without_the_compiled_function(monkeypatch: pytest.MonkeyPatch) -> None:
    batches = made_up_batches(3, size=50)
    found = list(map(rows_of, batches))
    monkeypatch.setattr(compiled, "codec", None)
    assert plain_lines(batches[0][0]) is None
    assert list(map(rows_of, batches)) == found


@given(st.lists(batches(), min_size=1, max_size=2))
def test_what_is_refused_does_not_depend_on_the_compiled_function(offered: list[list[LedgerRun]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        found = [_said(batch) for batch in offered]
        patch.setattr(compiled, "codec", None)
        assert [_said(batch) for batch in offered] == found


def _said(batch: list[LedgerRun]) -> object:
    try:
        return rows_of(batch)
    except InvalidRun as error:
        return str(error)
