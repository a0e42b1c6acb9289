"""What a writer refuses before anything is in the ledger: what `verify` would reject, and what breaks a run.

Each is reported with run, seq and field.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import InvalidRun, UsageError
from fsar_ledger.events.envelope import with_columns
from fsar_ledger.ledger.rows.check import first_flaw
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.ledger.rows.schema import COLUMNS, LAYOUTS, OPENINGS, PAYLOAD, STANDS_ALONE, STORED, StoredType
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.forgery import changed
from tests.ledger.samples import append_all, contents, made_up_batches, run_of_every_type
from tests.ledger.test_plan_rows import PLAN
from tests.ledger.test_writer_property import Number, Pair, Posing, Stranger, Word, with_event

RUN = run_of_every_type("run-1", seed=3)
BATCHES = made_up_batches(4)
COMMITTED = BATCHES[:2]


def seq_with(condition: Callable[[str, StoredType], bool]) -> tuple[int, str]:
    """Return the first event of RUN that has such a field, and the field's name."""
    layouts = [(seq, LAYOUTS[str(event.__struct_config__.tag)]) for seq, event in enumerate(RUN.events)]
    return next(
        (seq, name)
        for seq, layout in layouts
        if seq > 0
        for name in (field.name for field in layout.fields)
        if condition(name, layout)
    )


def of_kind(kind: str, *, closed: bool = False, is_nullable: bool = False) -> tuple[int, str]:
    def fits(name: str, layout: StoredType) -> bool:
        (field,) = (field for field in layout.fields if field.name == name)
        return (field.kind, field.values is not None, field.is_nullable) == (kind, closed, is_nullable)

    return seq_with(fits)


def one(**changes: Any) -> LedgerRun:
    """The run with these changes."""
    return msgspec.structs.replace(RUN, **changes)


def refused(path: Path, runs: list[LedgerRun], said: str) -> None:
    """Check that staging them is refused with these words and leaves nothing behind."""
    before = contents(path)
    with pytest.raises(InvalidRun, match=said):
        stage(path, runs)
    assert contents(path) == before


WRONG: dict[str, tuple[tuple[int, str], tuple[object, ...]]] = {
    "text": (of_kind("string"), (None, 1, True, b"robot/A1", ("robot/A1",), Word.FSAR, Posing("robot/A1"), "\ud800")),
    "of a closed list": (
        of_kind("string", closed=True),
        (None, 1, "perhaps", "", "Local", Word.FSAR, Posing("perhaps")),
    ),
    "an integer": (of_kind("integer"), (None, True, 1.0, "1", Number.ONE, 2**53, -(2**53), 2**63, 2**200)),
    "yes or no": (of_kind("boolean"), (None, 0, 1, "true")),
    "names": (
        of_kind("strings"),
        (None, "ab", ["a"], Pair(("a",)), {"a": 1}, (1,), (None,), (b"a",), (Posing("a"),), ("\ud800",)),
    ),
}
EACH = [(kind, value) for kind, (_, values) in WRONG.items() for value in values]


@pytest.mark.parametrize(("kind", "value"), EACH, ids=[f"{kind}: {value!a:.20}" for kind, value in EACH])
def test_a_value_that_its_field_cannot_hold_is_refused(path: Path, kind: str, value: object) -> None:
    (seq, field), _ = WRONG[kind]
    run = with_event(RUN, seq, with_columns(RUN.events[seq], **{field: value}))
    refused(
        path,
        [BATCHES[2][0], run],
        f"run run-1, seq {seq}, field {field}: found {re.escape(f'{value!r:.80}')}, expected .*; nothing was written",
    )


def test_closed_lists_are_the_same_for_writer_and_verifier() -> None:
    closed = [(layout, field) for layout in LAYOUTS.values() for field in layout.fields if field.values is not None]
    assert len(closed) > 20
    for layout, field in closed:
        event = next(event for event in RUN.events if type(event) is layout.cls)
        values = sorted(field.values or ())
        events = [with_columns(event, **{field.name: value}) for value in values]
        good = LedgerRun("r", range(len(events)), [None, *range(len(events) - 1)], events)
        table = encode([good])
        assert first_flaw(table) is None
        with pytest.raises(
            InvalidRun,
            match=re.escape(expected := f"seq 0, field {field.name}: found 'perhaps', expected one of {values}"),
        ):
            encode([with_event(good, 0, with_columns(event, **{field.name: "perhaps"}))])
        assert expected in str(first_flaw(changed(table, field.name, 0, "perhaps")))


@pytest.mark.slow
def test_a_row_by_itself_has_the_values_of_its_type_and_no_other() -> None:
    """As in a journal, of which each commit is looked at by itself."""
    rows, values = encode([RUN]), {"string": "text", "integer": 1, "boolean": True, "strings": ["text"]}
    types = [type(event) for event in RUN.events]
    for layout in (one for one in LAYOUTS.values() if one.cls in types):
        alone = rows.slice(types.index(layout.cls), 1)
        assert first_flaw(alone, is_whole=False) is None
        for field in layout.fields:
            flaw = first_flaw(changed(alone, field.name, 0, None), is_whole=False)
            assert (flaw is None) is field.is_nullable, field.name
        name = next(name for name in PAYLOAD if name not in {field.name for field in layout.fields})
        assert "has no such field" in str(first_flaw(changed(alone, name, 0, values[COLUMNS[name]]), is_whole=False))


@pytest.mark.parametrize("event", [Stranger("robot/A1"), "RunStarted.v1", None, {}, Stranger])
def test_what_is_no_event_of_today_is_refused(path: Path, event: object) -> None:
    refused(
        path,
        [with_event(RUN, 4, event)],
        "run run-1, seq 4, field type: found .*, expected an event of a type that is written today",
    )


@pytest.mark.parametrize(
    ("time", "said"),
    [(True, "True"), (1.0, r"1\.0"), (None, "None"), (2**53, "9007199254740992, expected at most"), (2**64, "1844")],
)
def test_a_time_that_is_none_is_refused(path: Path, time: Any, said: str) -> None:
    times = [*RUN.times_us[:-1], time]
    refused(path, [one(times_us=times)], f"run run-1, seq {len(times) - 1}, field time_us: found {said}")


def test_time_that_runs_backwards_is_refused(path: Path) -> None:
    times = [*RUN.times_us[:5], RUN.times_us[4] - 1, *RUN.times_us[6:]]
    refused(
        path,
        [BATCHES[2][0], one(times_us=times)],
        f"run run-1, seq 5, field time_us: found {times[5]}, expected no less",
    )
    same = [*RUN.times_us[:5], RUN.times_us[4], *RUN.times_us[6:]]
    assert stage(path, [BATCHES[2][0], one(times_us=same)]).rows == len(BATCHES[2][0].events) + len(RUN.events)


@pytest.mark.parametrize(
    ("seq", "cause"), [(0, 0), (0, -1), (3, 3), (3, 4), (3, -1), (3, True), (3, 1.0), (3, "1"), (3, 2**64)]
)
def test_a_cause_that_is_no_earlier_event_is_refused(path: Path, seq: int, cause: Any) -> None:
    causes = [*RUN.caused_by[:seq], cause, *RUN.caused_by[seq + 1 :]]
    refused(path, [one(caused_by=causes)], f"run run-1, seq {seq}, field caused_by: found {cause!r}, expected")


def test_a_run_begins_with_its_start_and_has_no_other(path: Path) -> None:
    assert {tag for tag in STORED if tag.startswith("RunStarted.v")} | STANDS_ALONE == OPENINGS
    headless = LedgerRun("run-1", RUN.times_us[1:], [None, *[0] * (len(RUN.events) - 2)], RUN.events[1:])
    refused(
        path,
        [BATCHES[2][0], headless],
        r"run run-1, seq 0, field type: found '\w+\.v\d+', expected one of \['ExperimentPlanned.*RunStarted",
    )
    refused(
        path,
        [with_event(RUN, 5, RUN.events[0])],
        "run run-1, seq 5, field type: found 'RunStarted.*, expected no second beginning of a run",
    )


def test_what_stands_alone_is_in_no_run(path: Path) -> None:
    assert stage(path, [LedgerRun("plan", [0], [None], [PLAN])]).rows == 1
    refused(
        path,
        [with_event(RUN, 0, PLAN)],
        r"run run-1, seq 0, field type: found 'ExperimentPlanned.v1', expected the only event of its run",
    )
    refused(
        path,
        [with_event(RUN, 7, PLAN)],
        "run run-1, seq 7, field type: found 'ExperimentPlanned.v1', expected no second beginning",
    )


@pytest.mark.parametrize("name", [None, 1, b"run", Word.LIVE, Posing("run"), ("run",), ["run"]])
def test_a_run_whose_name_is_no_string_is_refused(path: Path, name: Any) -> None:
    refused(path, [one(run_id=name)], "field run_id: found .*, expected a string")


def test_a_name_that_no_file_can_hold_as_text_is_refused(path: Path) -> None:
    with pytest.raises(InvalidRun, match=r"field run_id: found '\\ud800', expected text without surrogates"):
        stage(path, [one(run_id="\ud800")])


def test_a_name_that_no_record_could_carry_is_refused(path: Path) -> None:
    refused(path, [one(run_id="é" * 2049)], "field run_id: found a name of 4098 bytes, expected at most 4096")
    append_all(path, [[one(run_id='"' * 4096)]])
    assert verify(path).ok
    with pytest.raises(ValueError, match="found an origin of 5000 characters, expected at most 4096 bytes"):
        Writer(path.parent / "other", "x" * 5000)
    assert not (path.parent / "other").exists()


@pytest.mark.parametrize("name", ["times_us", "caused_by", "events"])
def test_a_run_that_lacks_something_or_all_is_refused(path: Path, name: str) -> None:
    refused(path, [one(**{name: getattr(RUN, name)[:-1]})], "run run-1: found .* expected as many of each")
    refused(
        path,
        [LedgerRun("run-1", [], [], [])],
        "run run-1: found 0 events, 0 times and 0 causes, expected .*, at least 1",
    )


def test_a_refusal_is_a_mistake_of_the_caller(path: Path) -> None:
    assert issubclass(InvalidRun, UsageError)
    assert issubclass(InvalidRun, ValueError)
    assert InvalidRun.exit_code == 2
