"""Runs that do not follow the one that they say they continue are not written, but found, and not answered about."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import InvalidRun, LedgerCorrupted
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.blocks import Runs
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.locations import record_of
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.relation import _chains
from tests.ledger.agreement import Case, judged
from tests.runtime.test_cuts import Day, commands_of, replayed


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[LedgerRun]:
    """The runs `hall`, `hall.2` and `hall.3`, each of which continues the one before."""
    commands, ends_us = commands_of(2)
    day = Day(tmp_path_factory.mktemp("halls") / "cut").plays(commands, (20, 50), ends_us)
    return [with_fields(one, goes_on=True) for one in open_ledger(day.ledger).runs()]


def other(parts: list[LedgerRun], **fields: object) -> list[LedgerRun]:
    """The runs, of which the second says something else of how it continues."""
    first, second, *rest = parts
    started, continued, *events = second.events
    changed = msgspec.structs.replace(continued, **fields)
    return [first, with_fields(second, events=[started, changed, *events]), *rest]


def with_fields(run: LedgerRun, **fields: Any) -> LedgerRun:
    return msgspec.structs.replace(run, **fields)


def later(run: LedgerRun, events: int) -> LedgerRun:
    """So many more events of the run, as its last."""
    end = len(run.events)
    return LedgerRun(run.run_id, run.times_us[-events:], [None] * events, run.events[-events:], end, goes_on=True)


def written(ledger: Path, runs: Iterable[LedgerRun]) -> Path:
    """A ledger of these runs, a commit for each, by a writer that does not look at how they continue each other."""
    with pytest.MonkeyPatch.context() as careless, Writer(ledger, "tests/cut") as writer:
        careless.setattr(Runs, "_wrongly_continued", lambda *_: None)
        for run in runs:
            writer.commit([run])
    return ledger


def wrong(case: str, parts: list[LedgerRun]) -> tuple[list[LedgerRun], str]:
    """The runs of this case, and what is said of them."""
    first, second, third = parts
    end = len(first.events) - 1
    match case:
        case "two runs continue one":
            fork = with_fields(second, run_id="fork")
            return [*parts, fork], "found 'hall', expected a run that none continues, as 'hall.2' does"
        case "another last event":
            return other(parts, continues_seq=3), f"found 3, expected {end}, the last of run 'hall'"
        case "itself":
            return other(parts, continues="hall.2"), "field continues: found 'hall.2', expected another run"
        case "a run that begins later":
            runs = [*other(parts, continues="late")[:2], with_fields(first, run_id="late")]
            return runs, "found its first event, expected none after run 'hall.2', which continues it"
        case "a circle":
            runs = [*other(parts, continues="hall.3")[:2], third]
            return runs, "found its first event, expected none after run 'hall.2', which continues it"
        case "a run that goes on":
            runs = [*parts, later(first, 2)]
            return runs, "found more events of the run, expected none after run 'hall.2', which continues it"
        case _:
            times_us = [first.times_us[-1] - 1, *second.times_us[1:]]
            runs = [first, with_fields(second, times_us=times_us), third]
            return runs, f"field time_us: found {times_us[0]}, expected no less than at the end of run 'hall'"


CASES = (
    *("two runs continue one", "another last event", "itself", "a run that begins later", "a circle"),
    *("a run that goes on", "a time before its end"),
)


@pytest.mark.parametrize("case", CASES)
def test_what_does_not_follow_is_found_and_nothing_is_answered_about_it(
    case: str, parts: list[LedgerRun], tmp_path: Path
) -> None:
    runs, said = wrong(case, parts)
    ledger = written(tmp_path / "other", runs)
    [problem] = fsar_ledger.Ledger(ledger).verify().problems
    assert said in str(problem)
    assert judged(Case(case, ledger, False)).difference == ""
    opened = fsar_ledger.Ledger(ledger)
    answers = (
        lambda: opened.metrics(),
        lambda: opened.audit(),
        lambda: opened.query("facts/claims"),
        lambda: opened.sql("SELECT count(*) AS events FROM events"),
        lambda: opened.log("hall").rows(),
        lambda: opened.state("hall.2"),
        lambda: record_of(open_ledger(ledger), "hall"),
    )
    for answer in answers:
        with pytest.raises(LedgerCorrupted, match="run fsar-ledger verify"):
            answer()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("is_staged", [False, True])
def test_what_does_not_follow_is_not_written(
    case: str, parts: list[LedgerRun], tmp_path: Path, is_staged: bool
) -> None:
    *runs, last = wrong(case, parts)[0]
    runs = [one for one in runs if one.run_id != "hall.3"]
    ledger = tmp_path / "other"

    def write() -> None:
        for run in (*runs, last):
            if is_staged:
                writer.append(stage(ledger, [run]))
            else:
                writer.commit([run])

    with Writer(ledger, "tests/cut") as writer, pytest.raises(InvalidRun) as refused:
        write()
    assert wrong(case, parts)[1] in str(refused.value)


@pytest.mark.slow
def test_what_does_not_follow_is_found_in_segments(parts: list[LedgerRun], tmp_path: Path) -> None:
    for case in CASES:
        runs, said = wrong(case, parts)
        ledger = written(tmp_path / case, runs)
        with Writer(ledger, "tests/cut") as writer:
            writer.seal()
        assert said in str(fsar_ledger.Ledger(ledger).verify().problems[0]), case
        assert judged(Case(case, ledger, False)).difference == ""


@pytest.mark.parametrize("is_sealed", [False, True])
def test_both_verifiers_find_nothing_where_runs_follow_one_another(
    parts: list[LedgerRun], tmp_path: Path, is_sealed: bool
) -> None:
    first, second, third = parts
    pieces = [piece(second, 0, 1), piece(second, 1, 9), piece(second, 9, len(second.events))]
    with Writer(tmp_path / "ledger", "tests/cut") as writer:
        for run in (first, *pieces, third):
            writer.commit([run])
            if is_sealed:
                writer.seal()
    assert judged(Case("cut", tmp_path / "ledger", True)).difference == ""
    assert [run.run_id for run in open_ledger(tmp_path / "ledger").runs()] == ["hall", "hall.2", "hall.3"]
    assert (
        len(record_of(open_ledger(tmp_path / "ledger"), "hall.3").events) == sum(len(one.events) for one in parts) - 2
    )


def test_a_writer_that_is_opened_again_knows_which_runs_continue_which(parts: list[LedgerRun], tmp_path: Path) -> None:
    ledger = written(tmp_path / "ledger", parts)
    with Writer(ledger, "tests/cut") as writer, pytest.raises(InvalidRun, match="expected a run that none continues"):
        writer.commit([with_fields(parts[1], run_id="fork")])
    with Writer(ledger, "tests/cut") as writer, pytest.raises(InvalidRun, match="found more events of the run"):
        writer.commit([later(parts[0], 1)])
    assert replayed(ledger) == ""


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"state_sha256": "0" * 64}, "field state_sha256: found"),
        ({"continues_root": "0" * 64}, "field continues_root: found"),
        ({"continues": "another"}, "field continues: found 'another', expected a run that the ledger holds before"),
    ],
)
def test_a_run_that_says_otherwise_how_it_continues_is_found_by_the_replay(
    parts: list[LedgerRun], tmp_path: Path, fields: dict[str, object], said: str
) -> None:
    assert said in replayed(written(tmp_path / "other", other(parts, **fields)))


def test_the_root_of_another_commit_is_found_by_the_replay(parts: list[LedgerRun], tmp_path: Path) -> None:
    view = open_ledger(written(tmp_path / "ledger", parts))
    for name, commit in (("before", None), ("after", view.commits[1])):
        ledger = tmp_path / name
        root = view.commits[0].tree_root if commit is None else commit.tree_root
        if commit is None:  # the root of half of the first run
            half = len(parts[0].events) // 2
            pieces = [piece(parts[0], 0, half), piece(parts[0], half, len(parts[0].events))]
            root = open_ledger(written(tmp_path / "half", pieces[:1])).head.root
            written(ledger, [*pieces, *other(parts, continues_root=root)[1:]])
        else:
            written(ledger, other(parts, continues_root=root))
        expected = f"field continues_root: found {root!r}, expected the root of the ledger when run hall had ended"
        assert expected in replayed(ledger), name


def test_a_cut_within_a_run_is_found_by_the_replay(parts: list[LedgerRun], tmp_path: Path) -> None:
    whole = record_of(open_ledger(written(tmp_path / "ledger", parts)), "hall.3")
    cut = next(seq for seq, event in enumerate(whole.events) if isinstance(event, RunContinued))
    expected = f"run one, seq {cut}, field type: found another one, expected a cut at event 1 of a run alone"
    assert expected in replayed(written(tmp_path / "one", [with_fields(whole, run_id="one")]))
    two = with_fields(parts[2], events=[*parts[2].events, parts[2].events[1]])
    two = with_fields(two, times_us=[*two.times_us, two.times_us[-1] + 1], caused_by=[*two.caused_by, 0])
    assert f"seq {len(whole.events)}, field continues_seq: found" in replayed(
        written(tmp_path / "two", [*parts[:2], two])
    )


def test_a_run_whose_past_was_changed_is_found_by_the_replay(parts: list[LedgerRun], tmp_path: Path) -> None:
    first, *rest = parts
    tasks = [seq for seq, event in enumerate(first.events) if type(event).__name__ == "TaskArrived"]
    shorter = [event for seq, event in enumerate(first.events) if seq != tasks[-1]]
    changed = LedgerRun("hall", first.times_us[:-1], first.caused_by[:-1], shorter, goes_on=True)
    runs = other([changed, *rest], continues_seq=len(shorter) - 1)
    assert "found" in replayed(written(tmp_path / "other", runs))


def test_a_run_that_begins_otherwise_than_the_one_that_it_continues_is_refused(
    parts: list[LedgerRun], tmp_path: Path
) -> None:
    first, second, *rest = parts
    started = second.events[0]
    assert isinstance(started, RunStarted)
    changed = [msgspec.structs.replace(started, fleet_size=8), *second.events[1:]]
    ledger = written(tmp_path / "other", [first, with_fields(second, events=changed), *rest])
    with pytest.raises(LedgerCorrupted, match="which it continues, expected the same"):
        record_of(open_ledger(ledger), "hall.2")
    with pytest.raises(LedgerCorrupted, match="which it continues, expected the same"):
        fsar_ledger.Ledger(ledger).state("hall.2")
    with pytest.raises(LedgerCorrupted, match="which it continues, expected the same"):
        fsar_ledger.Ledger(ledger).metrics()
    assert "which it continues, expected the same" in replayed(ledger)


def test_rows_that_contradict_the_index_are_not_merged(parts: list[LedgerRun], tmp_path: Path) -> None:
    """Whoever reads rows that were not compared with the index is told of two runs that continue one, too."""
    ledger = written(tmp_path / "other", [*parts, with_fields(parts[1], run_id="fork")])
    with pytest.MonkeyPatch.context() as blind:
        blind.setattr("fsar_ledger.metrics.database.earlier_runs", lambda _: {})
        with pytest.raises(LedgerCorrupted, match="expected one that does"):
            connect(ledger)


def test_runs_that_claim_to_continue_each_other_in_a_circle_are_read_as_they_are() -> None:
    sizes = {"a": 5, "b": 5}
    assert _chains({"a": "b", "b": "a"}, sizes) == []
    [chain] = _chains({"c": "a", "a": "b", "b": "a"}, {**sizes, "c": 5})
    assert [*chain][-1] == "c"
