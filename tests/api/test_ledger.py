"""A ledger from Python: names, times, events as objects and as tables, and what is refused."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pyarrow.compute as pc
import pytest
from msgspec.structs import replace

import fsar_ledger
from fsar_ledger.analysis.causes import Element
from fsar_ledger.api.answers import Screen
from fsar_ledger.api.cause import CauseResult
from fsar_ledger.api.files import whole_file
from fsar_ledger.api.table import Table
from fsar_ledger.base.errors import (
    InvalidExperiment,
    LedgerCorrupted,
    QueryFailed,
    UnknownQuery,
    UsageError,
    WriteFailed,
)
from fsar_ledger.base.publishing import publish
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.metrics import definitions
from fsar_ledger.projections.fold import fold
from tests.api.conftest import RUN


def test_a_run_is_found_by_a_part_that_only_one_has(ledger: fsar_ledger.Ledger) -> None:
    names = {row["run_id"] for row in ledger.runs()}
    assert {logged.run for logged in ledger.events(run=RUN)} == {next(name for name in names if RUN in name)}
    with pytest.raises(UsageError, match="found 3 runs whose names contain this"):
        ledger.events(run="r0001")
    with pytest.raises(UsageError, match=r"no such run; did you mean fsar\.full\.door-relay"):
        ledger.events(run="fsar.full.dor-relay")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"robot": "B9"}, "no such robot; did you mean robot/"),
        ({"since": 3.0, "until": 3.0}, "expected an earlier time first"),
        ({"since": -1.0}, "expected seconds of run time"),
        ({"until": float("nan")}, "expected seconds of run time"),
        ({"since": "3 minutes"}, "expected seconds of run time"),
        ({"since": 100_000}, "expected at most .* s, the last event of the longest run"),
        ({"run": ""}, "there is no such run"),
    ],
)
def test_a_wrong_name_or_time_is_an_error_and_no_empty_answer(
    ledger: fsar_ledger.Ledger, asked: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        ledger.events(**asked)  # type: ignore[arg-type]


def test_what_a_decider_was_told_ages_while_nothing_happens(ledger: fsar_ledger.Ledger) -> None:
    record = ledger.record(1)
    between = zip(record.times_us, record.times_us[1:], record.events, strict=False)
    later_us, learned = next(
        (next_us - 1, event)
        for time_us, next_us, event in between
        if isinstance(event, FleetRuleLearned) and next_us - time_us > 200_000
    )
    found = ledger.state(1, at=later_us / 1e6, as_known_by=learned.robot).beliefs or []
    ages = {one.what: one.age_s for one in found}
    assert ages["fleet's rule"] == (later_us - learned.as_of_us) / 1e6
    assert ages["own policy"] == 0


def test_a_command_of_a_simulated_run_is_one_of_its_facts_and_answers(ledger: fsar_ledger.Ledger) -> None:
    leaves = "command:LeaveFleet/0"
    element = Element(leaves, "robot/B1: gives the command: LeaveFleet", 90, 12.0, True, f"drop {leaves}")
    found = CauseResult(
        run=ledger.record(1).run_id,
        outcome="authority_conflicts > 0",
        elements=(element,),
        presupposed=(replace(element, name="task:A1-1"), replace(element, name="task:A1-2")),
        unknown=(),
        also_necessary=(),
        candidates=60,
        forks=9,
        chances=(),
        last_open_s=None,
        closing_seq=None,
        closing_s=None,
        provenance=ledger.runs().provenance,
    )
    text = "".join(found.text(Screen(ledger)))
    assert "1 of 60 facts and answers suffices; without it the outcome does not occur" in text
    assert "task:A1-1, task:A1-2 are presupposed: without any one of them, there is no value to compare" in text


def test_calls_that_make_no_sense_are_errors_of_the_package(ledger: fsar_ledger.Ledger) -> None:
    with pytest.raises(UsageError, match="changes: found no change, expected one at least"):
        ledger.whatif([], 1)
    for name in ("fsar", "no-such"):
        with pytest.raises(
            UsageError, match="run=1 and architecture: found one run, expected architecture with all runs"
        ):
            ledger.whatif("drop window:*", 1, architecture=name)
    with pytest.raises(UsageError, match="table: found Moment"):
        ledger.state(1, at=5).table()


def test_wrong_names_in_questions_are_errors(ledger: fsar_ledger.Ledger) -> None:
    with pytest.raises(UnknownQuery, match="did you mean"):
        ledger.query("refusls")
    with pytest.raises(InvalidExperiment, match="unknown metric"):
        ledger.multiverse(metric="coordination")
    with pytest.raises(UsageError, match=r"pool=.*expected pool=seeds, or no pool"):
        ledger.metrics(pool="all")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "asked",
    [{"run": RUN}, {"run": RUN, "robot": "B1"}, {"robot": "robot/A1", "since": 5, "until": 20.5}, {"until": 0.000001}],
)
def test_events_are_the_same_as_objects_and_as_a_table(ledger: fsar_ledger.Ledger, asked: dict[str, object]) -> None:
    events = ledger.events(**asked)  # type: ignore[arg-type]
    objects = sorted((one.run, one.seq, one.time_us, type(one.event).__name__) for one in events)
    table = events.arrow().select(["run_id", "seq", "time_us", "type"]).to_pylist()
    assert objects == [(row["run_id"], row["seq"], row["time_us"], row["type"].partition(".")[0]) for row in table]
    assert objects
    assert events.polars().height == len(objects) == events.duckdb().shape[0]


def test_events_of_a_robot_are_those_that_name_it(ledger: fsar_ledger.Ledger) -> None:
    every, ours = ledger.events(run=RUN), ledger.events(run=RUN, robot="B1")
    seqs = {one.seq for one in ours}
    assert 0 < len(seqs) < sum(1 for _ in every)
    assert seqs == {one.seq for one in every if "'robot/B1'" in repr(one.event) or "'agent/B1/" in repr(one.event)}


def test_since_is_included_and_until_is_not(ledger: fsar_ledger.Ledger) -> None:
    times = sorted({one.time_s for one in ledger.events(run=RUN)})
    first, last = times[3], times[6]
    assert sorted({one.time_s for one in ledger.events(run=RUN, since=first, until=last)}) == times[3:6]


def test_the_state_at_a_time_is_what_the_events_until_then_make(ledger: fsar_ledger.Ledger) -> None:
    every = list(ledger.events(run=RUN))
    at = every[len(every) // 2].time_s
    assert ledger.state(RUN, at).state == fold(one.event for one in every if one.time_s <= at)
    assert ledger.state(RUN).state == fold(one.event for one in every)
    assert ledger.state(RUN, at).state != ledger.state(RUN).state


def test_sql_reads_this_ledger_and_nothing_else(ledger: fsar_ledger.Ledger) -> None:
    table = ledger.sql("SELECT count(*) AS events, sum(seq) AS seqs FROM events")
    assert table.rows()[0]["events"] == ledger.head.size == table.polars()["events"][0]
    assert str(table.arrow().schema.field("seqs").type) == "int64"
    for sql in ("SELECT * FROM read_text('/etc/hostname')", "DROP TABLE events", "SELECT 1; SELECT 2"):
        with pytest.raises(QueryFailed):
            ledger.sql(sql)


def test_the_table_of_a_table_is_itself(ledger: fsar_ledger.Ledger) -> None:
    metrics = ledger.metrics()
    assert metrics.table() is metrics


def test_a_table_says_what_it_holds_for_and_shows_text_harmlessly(ledger: fsar_ledger.Ledger) -> None:
    table = ledger.sql("SELECT '<script>' || chr(27) || '[31m' AS evil, NULL AS nothing FROM range(30)")
    assert table.provenance.head == ledger.head
    shown = table._repr_html_()
    assert "&lt;script&gt;" in shown
    assert "<script>" not in shown
    assert "\x1b" not in shown
    assert "10 more rows" in shown
    assert repr(table) == "<Table: 30 rows of evil, nothing>"
    assert [row["nothing"] for row in table] == [None] * 30


def test_metrics_have_their_columns_and_types_in_every_form(ledger: fsar_ledger.Ledger) -> None:
    table = ledger.metrics()
    assert isinstance(table, Table)
    assert [row["metric"] for row in table] == [one.name for one in definitions.metrics() for _ in range(3)]
    assert 3 * len(definitions.published_metrics()) == 24
    assert "scenario" not in table.columns
    assert set(ledger.metrics(by="scenario").polars()["scenario"]) == {"door-relay"}
    assert str(table.arrow().schema.field("mean").type) == "double"
    assert pc.sum(table.arrow().column("n")).as_py() == sum(row["n"] for row in table)


def test_damage_is_told_and_refused(ledger: fsar_ledger.Ledger, copy: Path) -> None:
    assert ledger.verify().ok
    segment = next(copy.glob("segments/*"))
    segment.chmod(0o644)
    data = bytearray(segment.read_bytes())
    data[len(data) // 2] ^= 1
    segment.write_bytes(data)
    damaged = fsar_ledger.open_ledger(copy)
    found = damaged.verify()
    assert not found.ok
    assert found.problems
    assert found.root is None
    for answer in (damaged.metrics, damaged.runs, lambda: list(damaged.events()), lambda: damaged.sql("SELECT 1")):
        with pytest.raises(LedgerCorrupted):
            answer()
    with pytest.raises(LedgerCorrupted):
        fsar_ledger.open_ledger(copy, verified=True).runs()


def test_a_proof_of_an_event_shows_that_event(ledger: fsar_ledger.Ledger, tmp_path: Path) -> None:
    [run] = {one.run for one in ledger.events(run=RUN)}
    file = tmp_path / "event.tlog-proof"
    file.write_text(str(ledger.prove(f"{run}:3")))
    proven = fsar_ledger.verify_proof(file)
    assert (proven.event["run_id"], proven.event["seq"]) == (run, 3)
    file.write_text(file.read_text().replace("3", "4"))
    with pytest.raises(LedgerCorrupted):
        fsar_ledger.verify_proof(file)


def test_an_altered_copy_of_a_verified_ledger_is_not_opened_as_verified(ledger: fsar_ledger.Ledger, copy: Path) -> None:
    fsar_ledger.open_ledger(ledger.path, verified=True)
    fsar_ledger.open_ledger(copy, verified=True)
    segment = min(copy.rglob("*.parquet"))
    data = bytearray(segment.read_bytes())
    data[len(data) // 2] ^= 1
    segment.chmod(0o644)
    segment.write_bytes(data)
    with pytest.raises(LedgerCorrupted, match=segment.name):
        fsar_ledger.open_ledger(copy, verified=True)


def test_threads_that_write_one_file_leave_it_whole(tmp_path: Path) -> None:
    start = Barrier(2)

    def write(content: str) -> None:
        with whole_file(tmp_path / "rows.csv") as temporary:
            temporary.write_text(content)
            start.wait(5)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, ("first", "second")))
    assert [path.read_text() in ("first", "second") for path in tmp_path.iterdir()] == [True]


@pytest.mark.parametrize("name", ["rows.csv", "why.svg"])
def test_a_pipe_is_not_replaced_by_a_file(ledger: fsar_ledger.Ledger, tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(WriteFailed, match=r"it is a pipe or a device; expected the name of a file"):
        ledger.export(tmp_path / name, query="denials") if name == "rows.csv" else publish(tmp_path / name, b"drawn")
    assert [path.is_fifo() for path in tmp_path.iterdir()] == [True]
