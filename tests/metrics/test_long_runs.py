"""A run that was cut is judged some parts at a time, and what is said of it is what the whole says."""

import random
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pytest

import fsar_ledger
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.metrics import cuts, database, slices
from fsar_ledger.metrics.database import Database, Slices, connect, from_table
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.slices import Slice
from fsar_ledger.runtime.architectures.fsar.reports import ReportWindow
from fsar_ledger.runtime.handlers.task import SubmitTask
from tests.quick import few
from tests.runtime.test_cuts import Day
from tests.runtime.test_live import STEPS, A, B, C, Play, S
from tests.runtime.test_live_forks_at_random import answers
from tests.runtime.test_wrong_cuts import written

ADDING = sorted(cuts._adding())
SOME = ["coordination_success", "invariant_cases", "time_to_know_s"]
MOST = 1_500
"""Events that are judged at once, which are some parts of such a run."""


def weeks(tasks: int, seed: int) -> LedgerRun:
    """A fleet that takes one task after the other, fails, recovers, asks its supervisors and is forbidden things."""
    draw, play = random.Random(seed), Play()
    count, shut, waited = 0, None, True
    while count < tasks:
        asked = list(answers(play, draw))
        if shut and draw.random() < 0.5:
            play.give(ReportWindow(robot=shut, scope="local", window="w", outcome=None))
            shut = None
        elif not shut and draw.random() < 0.03:
            shut = draw.choice((A, B))
            play.give(ReportWindow(robot=shut, scope="local", window="w", outcome="deny"))
        elif not asked and waited:
            count, waited, who = count + 1, False, draw.choice((A, C))
            steps = STEPS if who == A else ("C navigate.indoor", "C door.open.secure B", "C inspect.visual")
            play.give(SubmitTask(robot=who, task_id=f"t{count}", steps=steps, budget_us=600 * S))
        elif asked:
            play.give(draw.choice(asked))
        else:
            play.wait(5)
            waited = True
    return play.wait(10).record


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger with such a run, in parts of 60 commands."""
    record = weeks(20, 3)
    path = tmp_path_factory.mktemp("weeks") / "ledger"
    pairs = zip(record.times_us, record.events, strict=True)
    commands = [(time_us, event) for time_us, event in pairs if isinstance(event, CommandGiven)]
    Day(path).plays(commands, range(60, len(commands), 60), record.times_us[-1])
    fsar_ledger.Ledger(path).compact()
    return path


@pytest.fixture(autouse=True)
def in_slices(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Have small ledgers judged in slices, with a cache of their own."""
    monkeypatch.setattr(database, "SLICE_EVENTS", MOST)
    monkeypatch.setattr(database, "LEAST_BYTES", -1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def looks(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """A list that gets the parts that are read together from now on."""
    found: list[tuple[str, ...]] = []
    fill = slices.fill

    def looked(database: Database, one: Slice, *args: Any) -> None:
        found.append(tuple(dict.fromkeys(each.run for each in one.runs)))
        fill(database, one, *args)

    monkeypatch.setattr(slices, "fill", looked)
    return found


def end_of(ledger: Path) -> int:
    return max(run.times_us[-1] for run in open_ledger(ledger).runs())


def rows(tables: Iterable[tuple[str, pa.Table]]) -> dict[str, list[str]]:
    return {name: sorted(map(str, slices.decoded(table).to_pylist())) for name, table in tables}


def whole(ledger: Path, *names: str) -> dict[str, list[str]]:
    with pytest.MonkeyPatch.context() as at_once, connect_at_once(at_once, ledger) as judged:
        return rows((name, judged.table(f"SELECT * FROM {name}")) for name in names or ADDING)


def connect_at_once(patch: pytest.MonkeyPatch, ledger: Path) -> Database:
    patch.setattr(database, "LEAST_BYTES", 1 << 20)  # as of a ledger of too few bytes for slices
    return connect(ledger)


def sliced(ledger: Path, *names: str) -> dict[str, list[str]]:
    return rows(Slices(open_for_answers(ledger)).rows_of([library().relations[name] for name in names or ADDING]))


@pytest.mark.parametrize("names", few([ADDING, SOME], [], [ADDING]))
def test_what_is_judged_part_by_part_adds_up_to_what_the_whole_says(
    names: list[str], cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = looks(monkeypatch)
    expected = whole(cut, *names)
    assert sliced(cut, *names) == expected
    assert len(set(seen)) > 2, "one begins the run, one goes on with it, one ends it"
    assert max(map(len, seen)) < len({run for runs in seen for run in runs}), "none is the whole"
    assert sum("'numerator'" in row and "'numerator': 0" not in row for found in expected.values() for row in found)


@pytest.mark.slow
def test_metrics_and_audit_are_those_of_the_whole(cut: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = looks(monkeypatch)
    ledger = fsar_ledger.Ledger(cut)
    found = ledger.metrics().rows(), ledger.audit().rows
    assert len(set(seen)) > 3
    monkeypatch.setattr(database, "LEAST_BYTES", 1 << 20)
    assert found == (ledger.metrics().rows(), ledger.audit().rows)


@pytest.mark.slow
def test_after_an_append_only_what_came_since_is_judged_and_compaction_forgets_nothing(
    cut: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger = shutil.copytree(cut, tmp_path / "ledger")
    sliced(ledger)
    day = Day(ledger)
    day.now_us = end_of(ledger) + S
    day.brings("late")
    day.one.cut()
    day.again().one.close()
    seen = looks(monkeypatch)
    expected = whole(ledger)
    assert sliced(ledger) == expected
    assert len(set(seen)) <= 2, "the last stretch, which may now be two"
    fsar_ledger.Ledger(ledger).compact()
    seen.clear()
    assert sliced(ledger) == expected
    assert len(set(seen)) <= 2


@pytest.mark.slow
def test_a_part_may_end_with_the_end_of_a_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    day = Day(tmp_path / "ledger")
    for count in range(1, 7):
        task, action = f"t{count}", f"t{count}/1.1"
        day.one.give("SubmitTask", A, robot=A, task_id=task, steps=STEPS[:1], budget_us=600 * S)
        for kind, given in (("ReportStart", {"robot": A}), ("ReportResult", {"executor": A, "result": "success"})):
            day.at(day.now_us + S).one.give(kind, A, action_id=action, **given)
        if count % 2 == 0:
            day.at(day.now_us + S).one.cut()
            day.again()
    day.one.close()
    last = next(iter(open_ledger(day.ledger).runs())).events[-1]
    assert isinstance(last, TaskCompleted)
    monkeypatch.setattr(database, "SLICE_EVENTS", 60)
    seen = looks(monkeypatch)
    assert sliced(day.ledger, *SOME) == whole(day.ledger, *SOME)
    assert len(seen) > 2
    assert max(map(len, seen)) < 4, "none is the whole"


@pytest.mark.slow
def test_where_a_task_comes_back_that_was_over_the_run_is_judged_as_a_whole(
    cut: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = list(open_ledger(cut).runs())
    done = next(event for event in parts[0].events if isinstance(event, TaskCompleted))
    again = next(
        event
        for event in parts[0].events
        if isinstance(event, ExecutionFinished) and event.subject.task_id == done.task_id
    )
    last = parts[-1]
    parts[-1] = LedgerRun(last.run_id, (*last.times_us, last.times_us[-1]), (*last.caused_by, 1), (*last.events, again))
    ledger = written(tmp_path / "again", parts)
    seen = looks(monkeypatch)
    assert sliced(ledger) == whole(ledger)
    assert max(map(len, seen)) == len(parts)


def test_numbers_are_added_and_subtracted_and_a_share_follows_from_them() -> None:
    def numbers(numerator: int, denominator: int) -> pa.Table:
        counts = {"numerator": [numerator], "denominator": [denominator]}
        return pa.table({"run_id": ["r"], **counts, "value": [0.0], "not_observed": pa.array([None], pa.string())})

    def sums(name: str) -> dict[str, Any]:
        signed = [(1, numbers(3, 6)), (-1, numbers(1, 2)), (1, numbers(2, 4))]
        [row] = cuts._added(name, signed).to_pylist()
        return {name: row[name] for name in ("numerator", "denominator", "value")}

    assert sums("coordination_success") == {"numerator": 4, "denominator": 8, "value": 0.5}
    assert sums("time_to_know_s") == {"numerator": 4, "denominator": 8, "value": 0.000_000_5}
    assert sums("human_intervention")["numerator"] == 3, "it says whether, and not how often"


@pytest.mark.slow
def test_a_judge_that_finds_more_in_what_is_carried_on_than_in_all_is_asked_of_the_whole(
    cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, expected, added = looks(monkeypatch), whole(cut, "invariant_cases"), cuts._added

    def twice(name: str, signed: Sequence[tuple[int, pa.Table]]) -> pa.Table:
        return added(name, [(2 * sign if sign < 0 else sign, table) for sign, table in signed])

    monkeypatch.setattr(cuts, "_added", twice)
    assert sliced(cut, "invariant_cases") == expected
    assert max(map(len, seen)) == len(list(open_ledger(cut).runs()))


@pytest.mark.parametrize("seed", few(range(8), [], range(2)))
def test_simulated_runs_of_this_architecture_can_be_cut_anywhere(tmp_path: Path, seed: int) -> None:
    """They are cut by nobody, and have more failures, windows and outages than a fleet that is played by hand."""
    draw = random.Random(seed)
    made = fsar_ledger.simulate(tmp_path / "ledger", architecture=["fsar"], runs=1, seed=seed).ledger
    with connect(made.path) as database:
        events = database.table("SELECT * FROM events ORDER BY run_id, seq")
        ends = database.rows("SELECT run_id, max(seq) AS last FROM events SEMI JOIN runs USING (run_id) GROUP BY ALL")
        expected = {name: database.table(f"SELECT * FROM {name}") for name in ADDING}
    judged = {row["run_id"]: by_parts(events, row["run_id"], row["last"], draw) for row in ends}
    sums = {name: [one[name] for one in judged.values() if one is not None] for name in ADDING}
    assert sum(one is not None for one in judged.values()) > len(judged) // 2, "most have no task that comes back"
    for name in ADDING:
        of_these = [row for row in expected[name].to_pylist() if judged[row["run_id"]] is not None]
        assert sorted(map(str, [row for table in sums[name] for row in table.to_pylist()])) == sorted(
            map(str, of_these)
        ), name


def by_parts(events: pa.Table, run: str, last: int, draw: random.Random) -> dict[str, pa.Table] | None:
    """What the parts of a run add up to, cut at random; None if a task comes back that was over."""
    ends = [*sorted(draw.sample(range(1, last), 4)), last]
    own = events.filter(pc.equal(events["run_id"], run))
    of_parts: dict[str, list[pa.Table]] = {name: [] for name in ADDING}
    carried, start = own.slice(0, 0), 0
    for end in ends:
        with from_table(pa.concat_tables([carried, own.slice(start, end + 1 - start)])) as database:
            part = cuts.settled(database, ADDING, None, is_last=end == last)
        if part is None:
            return None
        for name in ADDING:
            of_parts[name].append(part[name])
        carried, start = part["carried_events"], end + 1
    return {name: cuts.summed(name, tables) for name, tables in of_parts.items()}
