"""A live run that is cut goes on as another run: it decides as the uncut one, and is judged with it as one run."""

import random
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import duckdb
import msgspec
import pytest

import fsar_ledger
from fsar_ledger.analysis.moments import Timeline, past_at
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun, joined
from fsar_ledger.ledger.store.locations import end_of, pieces_of, record_of
from fsar_ledger.metrics.database import Database, Slices, connect
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.invariants import audit_rows, invariants
from fsar_ledger.metrics.library import Query, library
from fsar_ledger.runtime import federation
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.snapshot import snapshot_path
from tests.quick import few
from tests.runtime.test_live import STEPS, A
from tests.runtime.test_live_forks_at_random import busy

EPOCH_US = 1_772_359_200_000_000  # 2026-03-01T10:00:00Z
S = 1_000_000


class Day:
    """A federation whose clock is set to the time of each command. `run` is its name, `run.2` what continues it."""

    def __init__(self, ledger: Path, **given: Any) -> None:
        self.ledger, self.now_us, self._given = ledger, 0, given
        self.one = self.opened()

    def opened(self) -> Federation:
        return fsar_ledger.federate(self.ledger, run="hall", clock=self._clock, **self._given)

    def _clock(self) -> int:
        return (EPOCH_US + self.now_us) * 1_000

    def at(self, time_us: int) -> "Day":
        self.now_us = time_us
        self.one.advance()
        return self

    def again(self) -> "Day":
        """Another process opens the ledger."""
        self.one.close()
        self.one = self.opened()
        return self

    def brings(self, task: str, key: str | None = None) -> Any:
        return self.one.give("SubmitTask", A, key=key, robot=A, task_id=task, steps=STEPS, budget_us=600 * S)

    def plays(self, commands: Sequence[tuple[int, CommandGiven]], cuts: Iterable[int] = (), ends_us: int = 0) -> "Day":
        """Give the commands at their times; before these of them, by number, the run is cut."""
        held = set(cuts)
        for number, (time_us, command) in enumerate(commands):
            self.now_us = time_us
            if number in held:
                self.one.cut()
                self.again()
            self.one.decide(command)
            self.now_us = time_us + S // 2
            self.one.advance()
        self.now_us = max(self.now_us, ends_us)
        self.one.advance()
        self.one.close()
        return self

    @property
    def record(self) -> LedgerRun:
        return record_of(open_ledger(self.ledger), self.one.run)


def commands_of(seed: int) -> tuple[list[tuple[int, CommandGiven]], int]:
    """What everybody says in a busy fleet, and when the run has ended."""
    record = busy(seed).record
    pairs = zip(record.times_us, record.events, strict=True)
    return [(time_us, event) for time_us, event in pairs if isinstance(event, CommandGiven)], record.times_us[-1]


def without_cuts(record: LedgerRun) -> list[tuple[int, Any]]:
    pairs = zip(record.times_us, record.events, strict=True)
    return [(time_us, event) for time_us, event in pairs if not isinstance(event, RunContinued)]


@pytest.fixture(scope="module")
def halls(tmp_path_factory: pytest.TempPathFactory) -> tuple[Day, Day]:
    """The same commands, given to a run that is not cut, and to one that is cut twice."""
    commands, ends_us = commands_of(2)
    folder = tmp_path_factory.mktemp("halls")
    whole = Day(folder / "whole").plays(commands, ends_us=ends_us)
    return whole, Day(folder / "cut").plays(commands, (20, 50), ends_us)


def replayed(ledger: Path) -> str:
    """What the replay finds, in words; empty: that all is as recorded."""
    found = fsar_ledger.Ledger(ledger).verify(replay=True)
    assert found.report.ok, found.problems
    return "" if found.ok else "\n".join(map(str, found.replay.differences))  # type: ignore[union-attr]


@pytest.mark.parametrize("seed", few(range(1, 20), [1, 2], range(3, 20, 4)))
def test_a_run_that_is_cut_anywhere_decides_as_the_uncut_one_and_both_replay(tmp_path: Path, seed: int) -> None:
    commands, ends_us = commands_of(seed)
    cuts = random.Random(seed).sample(range(1, len(commands)), 3)
    whole = Day(tmp_path / "whole").plays(commands, ends_us=ends_us)
    cut = Day(tmp_path / "cut").plays(commands, cuts, ends_us)
    assert cut.one.run == "hall.4"
    assert without_cuts(cut.record) == without_cuts(whole.record)
    assert len(cut.record.events) == len(whole.record.events) + 3
    assert replayed(whole.ledger) == replayed(cut.ledger) == ""


def test_a_run_goes_on_from_the_state_of_the_one_before_however_it_is_opened(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    first = day.brings("t", key="k")
    assert day.at(5 * S).one.cut() == "hall.2"
    snapshot_path(day.ledger, "hall.2").unlink()  # so that all of it is made again
    for _ in range(2):
        day.again()
        assert day.one.run == "hall.2"
        assert day.brings("t", key="k").events == first.events, "it is known that it was given"
        assert day.brings("t").rejected is not None, "a name of the run before is not used again"
    day.at(2_000 * S)
    assert any(isinstance(event, TaskAbandoned) for event in day.record.events), "what was due then is due here"
    assert replayed(day.ledger) == ""


def test_the_new_run_says_which_it_continues_and_begins_as_that_one(halls: tuple[Day, Day]) -> None:
    view = open_ledger(halls[1].ledger)
    parts = {one.run_id: one for one in view.runs()}
    assert list(parts) == ["hall", "hall.2", "hall.3"]
    for before, name in (("hall", "hall.2"), ("hall.2", "hall.3")):
        started, continued = parts[name].events[:2]
        assert started == parts["hall"].events[0]
        assert isinstance(continued, RunContinued)
        assert (continued.continues, continued.continues_seq) == (before, len(parts[before].events) - 1)
        assert continued.continues_root in {commit.tree_root for commit in view.commits}
        assert parts[name].times_us[0] > parts[before].times_us[-1]


def rows_of(database: Database, query: Query, uncut: dict[int, int | None]) -> Counter[tuple[object, ...]]:
    """The rows of a query, with each seq as in the uncut run, and without what cannot be the same in both."""

    def seq(found: object) -> object:
        return [seq(one) for one in found] if isinstance(found, list) else uncut.get(found, found)  # type: ignore[call-overload]

    rows = database.query(query.name).to_pylist()
    return Counter(
        tuple(
            f"{seq(value)}" if "seq" in name or name == "made_by" else f"{value}"
            for name, value in row.items()
            if not name.endswith("run_id") and name not in ("number", "caused_by")
        )
        for row in rows
        if "RunContinued" not in f"{row.get('type')}"
    )


NAMES_SEQS_IN_TEXT = {"facts/mechanism_decisions"}
JUDGES = ("invariants/", "facts/verdict_events", "facts/late_tasks", "facts/claims", "metrics/coordination_success")
"""Those that look at what is open, or held, when a run is cut. The slow test asks every query."""


def compare(halls: tuple[Day, Day], queries: Iterable[Query]) -> int:
    """Compare what the queries answer about both runs; return how many gave rows."""
    uncut: dict[int, int | None] = {}
    for seq, event in enumerate(halls[1].record.events):
        cuts = sum(1 for one in uncut.values() if one is None)
        uncut[seq] = None if isinstance(event, RunContinued) else seq - cuts
    given = 0
    with connect(halls[0].ledger) as whole, connect(halls[1].ledger) as cut:
        for query in queries:
            expected, found = rows_of(whole, query, {}), rows_of(cut, query, uncut)
            if query.name not in {*NAMES_SEQS_IN_TEXT, "staging/run_continued"}:
                assert found == expected, query.name
            given += bool(found)
    return given


@pytest.mark.slow
def test_every_judge_says_the_same_of_the_cut_run_and_of_the_uncut_one(halls: tuple[Day, Day]) -> None:
    queries = [one for one in library().queries.values() if one.name.startswith(JUDGES) and not one.parameters]
    assert compare(halls, queries) > 3


@pytest.mark.slow
def test_every_query_says_the_same_of_the_cut_run_and_of_the_uncut_one(halls: tuple[Day, Day]) -> None:
    assert compare(halls, [one for one in library().queries.values() if not one.parameters]) > 100


def test_the_metrics_of_the_parts_add_up_to_those_of_the_whole(halls: tuple[Day, Day]) -> None:
    with connect(halls[1].ledger) as database:
        parts = database.query("audit/metrics_by_period", {"per": "part"}).to_pylist()
        whole = {row["metric"]: row for row in database.query("metrics/run_metrics").to_pylist()}
    assert list(dict.fromkeys(row["period"] for row in parts)) == ["hall", "hall.2", "hall.3"]
    for metric, scale in {one.name: one.scale for one in published_metrics()}.items():
        together = max if scale == "yes-no" else sum
        assert together(row["numerator"] for row in parts if row["metric"] == metric) == whole[metric]["numerator"]
        if scale in ("share", "seconds"):
            assert sum(row["denominator"] for row in parts if row["metric"] == metric) == whole[metric]["denominator"]


def test_judged_by_itself_the_second_run_would_be_broken(halls: tuple[Day, Day]) -> None:
    """What the join is for: without it, work that began before the cut is an offence after it."""
    with connect(halls[1].ledger) as database:
        database.prepare("SELECT * FROM events")
        alone = database.direct(
            "SELECT count(*) FROM events_by_run WHERE run_id = 'hall.3' AND type = 'RobotJoined.v1'"
        )
        [row] = database.rows("SELECT count(*) AS robots FROM robot_joined WHERE run_id = 'hall.3'")
    assert (alone, row["robots"]) == ([(0,)], 4)


@pytest.mark.slow
def test_slices_keep_runs_that_continue_each_other_together(
    halls: tuple[Day, Day], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsar_ledger.metrics.database.LEAST_BYTES", -1)
    sliced = Slices(open_ledger(halls[1].ledger), most=10)
    assert sliced._slices
    rows = audit_rows(sliced, invariants())
    with connect(halls[0].ledger) as whole:
        assert [msgspec.structs.replace(row, first_run=None) for row in rows] == audit_rows(whole, invariants())


@pytest.mark.parametrize("share", [0.3, 0.7, 1])
def test_what_is_read_piece_by_piece_is_the_record(halls: tuple[Day, Day], share: float) -> None:
    view = open_ledger(halls[1].ledger)
    run = {0.3: "hall", 0.7: "hall.2", 1: "hall.3"}[share]
    size = int(view.head.events * share)
    record, pieces = record_of(view, run, size), list(pieces_of(view, run, size))
    assert msgspec.structs.replace(joined(pieces), run_id=run) == record
    assert end_of(view, run, size) == record.times_us[-1]
    past = past_at(iter(pieces), record.times_us[-1])
    assert past == Timeline(record).past(len(record.events) - 1)


@pytest.mark.slow
def test_one_asks_about_any_of_them(halls: tuple[Day, Day]) -> None:
    ledger = fsar_ledger.Ledger(halls[1].ledger)
    cuts = [seq for seq, event in enumerate(halls[1].record.events) if isinstance(event, RunContinued)]
    lines = ledger.log("hall.2").rows()
    assert [row["seq"] for row in lines] == list(range(cuts[0], cuts[1])), "from its beginning on, counted on"
    assert lines[0]["message"] == "goes on from: hall"
    assert [row["seq"] for row in ledger.log("hall").rows()] == list(range(cuts[0]))
    then = ledger.state("hall.2", at=lines[0]["time_s"])
    assert (then.seq, then.standing) == (cuts[0], ledger.state("hall").standing), (
        "as it was at the end of the one before"
    )
    assert ledger.why(("hall.3", cuts[1] + 1)).made[0].seq == cuts[1] + 1
    assert ledger.why(f"hall.3:{cuts[1] + 1}").seq == cuts[1] + 1
    assert {row["run_id"] for row in ledger.query("audit/memberships", run="hall").rows()} == {"hall.3"}
    for name in ("hall", "hall.2", "hall.3"):
        told = [(one.seq, one.event) for one in ledger.events(name)]
        assert told == list(enumerate(halls[1].record.events))
        assert len(ledger.events(name).table().rows()) == len(told)
    with pytest.raises(UsageError, match="events in the run, expected a seq from 0 to"):
        ledger.why("hall.3:4000")


@pytest.mark.slow
def test_sql_and_a_file_of_duckdb_see_one_run(halls: tuple[Day, Day], tmp_path: Path) -> None:
    asked = "SELECT run_id, count(*) AS events, max(seq) AS last FROM events GROUP BY run_id"
    size = len(halls[1].record.events)
    ledger = fsar_ledger.Ledger(halls[1].ledger)
    assert ledger.sql(asked).rows() == [{"run_id": "hall.3", "events": size, "last": size - 1}]
    ledger.open(tmp_path / "cut.duckdb")
    with duckdb.connect(str(tmp_path / "cut.duckdb"), read_only=True) as file:
        assert file.sql(asked).fetchall() == [("hall.3", size, size - 1)]


HOUR = 3_600 * S


def cuts_of(day: Day) -> list[float]:
    """When the run was cut, in hours after 10:00."""
    pairs = zip(day.record.times_us, day.record.events, strict=True)
    return [round(time_us / HOUR, 6) for time_us, event in pairs if isinstance(event, RunContinued)]


def test_a_run_that_is_cut_daily_is_cut_at_midnight_and_once_for_days_without_anybody(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger", cut="daily")
    day.at(13 * HOUR).brings("t1")
    assert day.one.run == "hall"
    day.at(15 * HOUR).again().at(16 * HOUR).brings("t2")
    assert day.one.run == "hall.2"
    day.at(37 * HOUR)
    assert day.one.run == "hall.2"
    day.again().at(110 * HOUR).at(111 * HOUR)
    assert (day.one.run, cuts_of(day)) == ("hall.3", [14, 110])
    assert replayed(day.ledger) == ""


def test_a_run_is_cut_at_the_end_of_each_shift(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger", cut="06:00, 14:00,22:00")
    for hour in range(26):
        day.at(hour * HOUR).again()
    assert cuts_of(day) == [4, 12, 20]


@pytest.mark.parametrize("cut", ["", "weekly", "24:00", "06:00,,14:00", "06:00+01:00", "06:00Z"])
def test_what_is_no_time_of_the_day_is_refused(tmp_path: Path, cut: str) -> None:
    with pytest.raises(UsageError, match="expected daily, or times of day"):
        Day(tmp_path / "ledger", cut=cut)
    assert not (tmp_path / "ledger").exists()


def test_the_name_of_a_run_that_has_nothing_to_do_with_it_is_left_to_it(tmp_path: Path) -> None:
    fsar_ledger.federate(tmp_path / "ledger", run="hall.2").close()
    day = Day(tmp_path / "ledger")
    assert day.one.cut() == "hall.3"
    assert day.again().one.run == "hall.3"
    assert fsar_ledger.federate(tmp_path / "ledger", run="hall.2").run == "hall.2"


def test_a_name_that_another_writer_took_since_is_left_to_it(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    fsar_ledger.federate(day.ledger, run="hall.2").close()
    assert day.one.cut() == "hall.3"


def test_only_the_newest_run_has_a_snapshot(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    for hour in range(1, 4):
        day.at(hour * S).one.cut()
    found = [one for one in snapshot_path(day.ledger, "").parent.iterdir() if one.suffix != ".lock"]
    assert found == [snapshot_path(day.ledger, "hall.4")]


def test_a_cut_reads_nothing_of_what_was_written_in_years(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    day = Day(tmp_path / "ledger")
    day.at(S).brings("t1")
    monkeypatch.setattr(federation, "open_ledger", lambda _: pytest.fail("the ledger is opened"))
    assert day.one.cut() == "hall.2"


def test_a_run_that_was_continued_goes_on_in_the_one_that_continues_it(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    day.one.cut()
    assert day.one.cut() == "hall.3"
    day.one.close()
    with fsar_ledger.federate(day.ledger, run="hall.2") as one:
        assert one.run == "hall.3"


def test_a_part_that_the_ledger_had_not_recorded_by_a_commit_is_not_shown_as_of_then(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    day.at(S).one.cut()
    ledger, commits = fsar_ledger.open_ledger(day.ledger), len(open_ledger(day.ledger).commits)
    assert ledger.state("hall.2", by_commit=commits).commit == commits
    with pytest.raises(UsageError, match=rf"nothing of run hall\.2, which came with commit {commits}$"):
        ledger.state("hall.2", by_commit=commits - 1)
    day.one.close()


def test_who_follows_the_events_sees_them_count_on(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    day = Day(tmp_path / "ledger", on_commit=lambda first, rows: seen.append((first, rows.count(b"\n"))))
    day.brings("t1")
    day.at(S).one.cut()
    day.at(2 * S).brings("t2")
    assert [first for first, _ in seen] == [sum(rows for _, rows in seen[:at]) for at in range(len(seen))]
    assert sum(rows for _, rows in seen) == day.one.size == len(day.record.events)


def test_a_task_that_began_in_one_run_and_ended_in_the_next_is_no_lost_outcome(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    day.now_us = S
    day.one.give("SubmitTask", A, robot=A, task_id="t", steps=("A navigate.indoor",), budget_us=600 * S)
    day.at(2 * S).one.give("ReportStart", A, robot=A, action_id="t/1.1")
    day.at(3 * S).one.cut()
    day.at(4 * S).one.give("ReportResult", A, executor=A, action_id="t/1.1", result="success")
    assert any(isinstance(event, TaskCompleted) for event in day.record.events)
    with connect(day.ledger) as database:
        assert database.query("facts/late_tasks").num_rows == 0
        [row] = database.rows("SELECT value, denominator FROM coordination_success")
        assert (row["value"], row["denominator"]) == (1, 1)
        rows = audit_rows(database, invariants())
    assert all(row.holds is not False for row in rows)
