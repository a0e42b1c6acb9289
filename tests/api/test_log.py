"""The timeline of a run, from Python."""

import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger import Ledger
from fsar_ledger.api import events
from fsar_ledger.api.events import Filter, LogRequest, about_of
from fsar_ledger.api.table import Table
from fsar_ledger.base.errors import LedgerCorrupted, SequenceConflict, UsageError
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.ledger.rows.schema import CONCERNED
from fsar_ledger.ledger.store import append
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics import relation
from fsar_ledger.metrics.database import Database
from tests.api.conftest import RUN
from tests.metrics.test_long_runs import weeks
from tests.queries.histories import run
from tests.quick import few
from tests.recycled import from_rows
from tests.runtime.test_cuts import Day

Row = dict[str, Any]


class Waited(Exception):
    """There was nothing more to tell."""


def waits_once() -> None:
    raise Waited


def keep(told: list[Row], tables: Iterable[Table]) -> None:
    for table in tables:
        told += table.rows()


@pytest.fixture(scope="module")
def lines(ledger: Ledger) -> list[Row]:
    """The timeline of the run; for reading only."""
    return ledger.log(RUN).rows()


@pytest.fixture(scope="module")
def every_line(ledger: Ledger) -> list[Row]:
    """The timelines of all runs; for reading only."""
    return ledger.log("all").rows()


def test_each_event_of_a_run_is_one_line_in_order(ledger: Ledger, lines: list[Row]) -> None:
    assert [row["seq"] for row in lines] == list(range(len(list(ledger.events(RUN)))))
    assert all(RUN in row["run_id"] for row in lines)
    times = [row["time_s"] for row in lines]
    assert times == sorted(times)
    assert all(row["message"] for row in lines)


def test_without_a_run_it_is_the_first_as_in_explain(ledger: Ledger) -> None:
    assert ledger.log().rows()[0]["run_id"] == ledger.requests().rows()[0]["run_id"]


@pytest.mark.slow
def test_a_span_of_time_takes_its_beginning_and_not_its_end(ledger: Ledger, lines: list[Row]) -> None:
    first, last = lines[60]["time_s"], lines[80]["time_s"]
    assert ledger.log(RUN, since=first, until=last).rows() == [row for row in lines if first <= row["time_s"] < last]
    assert ledger.log(RUN, "10s", "20000ms").rows() == ledger.log(RUN, 10, "20").rows() != []


@pytest.mark.slow
def test_a_robot_and_concerns_narrow_the_lines(ledger: Ledger, lines: list[Row]) -> None:
    about_b1 = ledger.log(RUN, robot="B1")
    assert {row["seq"] for row in about_b1} == {one.seq for one in ledger.events(RUN, robot="B1")}
    both = ledger.log(RUN, about=["requests,policies", "trust"])
    assert {row["concern"] for row in both} == {"request", "policy", "trust"}
    assert len(both) == sum(CONCERNED.get(row["type"]) in {"request", "policy", "trust"} for row in lines)


@pytest.mark.parametrize("concern", few(CONCERNS, ["request", "trust", "world"], CONCERNS[1::2]))
def test_every_concern_can_be_asked_for(ledger: Ledger, concern: str) -> None:
    assert {row["concern"] for row in ledger.log("all", about=concern)} <= {concern}


@pytest.mark.slow
def test_all_runs_are_told_in_the_order_of_the_ledger(ledger: Ledger, every_line: list[Row]) -> None:
    runs = list(dict.fromkeys(one.run for one in ledger.events()))
    assert list(dict.fromkeys(row["run_id"] for row in every_line)) == runs
    assert [row for table in ledger.stream_log() for row in table] == every_line
    assert len(every_line) == ledger.head.size


@pytest.mark.slow
def test_a_span_may_end_after_the_run_but_not_begin_there(ledger: Ledger) -> None:
    assert ledger.log(1, until=9000).rows() == ledger.log(1).rows()
    assert list(ledger.events(1, until=9000)) == list(ledger.events(1))
    for ask in (ledger.log, ledger.events):
        with pytest.raises(UsageError, match="9000"):
            ask(1, since=9000)


def test_what_the_run_does_not_observe_is_said_where_it_is_asked_for() -> None:
    with from_rows(run(observes=["request", "trust"])) as database:
        about = {
            asked: [one.concern for one in about_of(database, LogRequest(Filter(), asked)).not_observed]
            for asked in [(), ("policy", "request"), ("trust",)]
        }
    assert about == {(): sorted({*CONCERNS} - {"request", "trust"}), ("policy", "request"): ["policy"], ("trust",): []}


@pytest.mark.slow
def test_a_stream_goes_on_with_the_commits_that_come(ledger: Ledger, every_line: list[Row], copy: Path) -> None:
    before, pauses = ledger.head.size, 0

    def pause() -> None:
        nonlocal pauses
        pauses += 1
        if pauses == 2:
            fsar_ledger.simulate(copy, scenario="door-relay", runs=3, seed=7, workers=1)
        if pauses == 4:
            raise Waited

    told: list[Row] = []
    with pytest.raises(Waited):
        keep(told, Ledger(copy).stream_log(pause=pause))
    assert told[:before] == every_line
    assert len(told) == Ledger(copy).head.size > before
    assert told == Ledger(copy).log("all").rows()


def follow_week(path: Path) -> Iterator[list[Row]]:
    """The lines of each look at a live run that goes on between the looks, and is cut and sealed meanwhile."""
    record = weeks(8, 3)
    pairs = zip(record.times_us, record.events, strict=True)
    commands = iter([(time_us, event) for time_us, event in pairs if isinstance(event, CommandGiven)])
    day = Day(path)

    def pause() -> None:
        day.one.cut()
        day.again()
        if not (some := list(islice(commands, 50))):
            raise Waited
        for time_us, command in some:
            day.at(time_us).one.decide(command)

    with suppress(Waited):
        yield from (table.rows() for table in Ledger(path).stream_log(pause=pause))


@pytest.mark.slow
def test_who_follows_a_long_run_is_told_each_line_from_what_is_new_and_what_was_carried_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[int] = []
    segment = View.segment

    def spied(view: View, number: int, *words: bool) -> Path:
        read.append(number)
        return segment(view, number, *words)

    monkeypatch.setattr(View, "segment", spied)
    monkeypatch.setattr(append, "SEAL_ROWS", 120)
    monkeypatch.setattr(events, "AFRESH", 100)
    told: list[Row] = []
    firsts: list[int] = []
    for rows in follow_week(tmp_path / "week"):
        told += [{**row, "run_id": None} for row in rows]
        firsts += [min(read)] if read else []
        read.clear()
    every = [{**row, "run_id": None} for row in Ledger(tmp_path / "week").log("all")]
    assert len(told) > 300
    assert told == every[: len(told)]
    assert firsts[-1] > 1
    assert firsts == sorted(firsts)


@pytest.mark.parametrize("what", few(["replaced", "damaged", "gone"], ["damaged"]))
def test_a_stream_ends_when_the_ledger_is_no_longer_the_one_it_told(copy: Path, what: str) -> None:
    checkpoint = (copy / "checkpoint").read_text()

    def pause() -> None:
        if not copy.exists() or (copy / "checkpoint").read_text() != checkpoint:
            raise Waited
        if what == "damaged":
            (copy / "checkpoint").write_text("nonsense\n")
            return
        shutil.rmtree(copy)
        if what == "replaced":
            fsar_ledger.simulate(copy, scenario="door-relay", runs=2, seed=8, workers=1)

    expected = {"replaced": "it was replaced", "damaged": "checkpoint", "gone": "no such path"}[what]
    kind = UsageError if what == "gone" else LedgerCorrupted
    with pytest.raises(kind, match=expected):
        list(Ledger(copy).stream_log(pause=pause))


@pytest.mark.slow
def test_a_stream_that_waits_cannot_demand_verified_rows(ledger: Ledger) -> None:
    with pytest.raises(UsageError, match="later"):
        fsar_ledger.open_ledger(ledger.path, verified=True).stream_log(pause=waits_once)
    assert sum(map(len, fsar_ledger.open_ledger(ledger.path, verified=True).stream_log())) == ledger.head.size


def test_a_compaction_is_no_damage_and_ends_no_stream(
    copy: Path, every_line: list[Row], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It removes segments that were there when the ledger was opened, and that are still to be read."""
    held = relation.hold_segments

    def compacted_first(database: Database, segments: list[Path], releases: list[str]) -> None:
        Ledger(copy).compact()
        held(database, segments, releases)

    tables = Ledger(copy).stream_log()
    monkeypatch.setattr(relation, "hold_segments", compacted_first)
    assert [row for table in tables for row in table] == every_line


def test_a_question_during_a_compaction_is_to_be_asked_again(copy: Path) -> None:
    with Ledger(copy).database() as database:
        Ledger(copy).compact()
        with pytest.raises(SequenceConflict, match="a compaction has replaced it meanwhile: run"):
            database.rows("SELECT count(DISTINCT robot) FROM events")
