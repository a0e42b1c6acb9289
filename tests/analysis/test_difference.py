"""Two runs are aligned by cause and content: exactly what was edited differs."""

from collections import Counter
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import pytest
from msgspec.structs import replace

import fsar_ledger
from fsar_ledger.analysis.difference import align, chain
from fsar_ledger.analysis.fork_base import base_of_record, rerun
from fsar_ledger.api.answers import Screen
from fsar_ledger.api.diff import diff_text, difference_of
from fsar_ledger.events import Event
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.events.world import PeersMet, SupervisorLeft, SupervisorReturned, TaskArrived
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import until
from fsar_ledger.runtime.change_texts import parsed
from tests.analysis.conftest import simulated
from tests.analysis.planted import planted
from tests.runtime.test_live import relay
from tests.runtime.test_live_forks import again

MIRROR = {"only first": "only second", "only second": "only first"}


def found(first: LedgerRun, second: LedgerRun) -> list[tuple[str, int | None]]:
    return [(one.kind, one.first_seq) for one in align(first, second).differences]


def test_a_run_does_not_differ_from_itself(runs: list[LedgerRun]) -> None:
    for run in runs:
        alignment = align(run, run)
        assert alignment.differences == []
        assert alignment.pairs == {seq: seq for seq in range(len(run.events))}
        assert alignment.same == len(run.events)


@pytest.mark.parametrize("cases", [60, pytest.param(1_000, marks=pytest.mark.slow)])
def test_exactly_the_planted_edits_are_found(runs: list[LedgerRun], cases: int) -> None:
    kinds: Counter[str] = Counter()
    for case in range(cases):
        run = runs[case % len(runs)]
        edited = planted(run, 1 + case % 6, case)
        assert Counter(found(run, edited.run)) == Counter(edited.edits), case
        kinds.update(kind for kind, _ in edited.edits)
    assert min(kinds[kind] for kind in ("only first", "only second", "changed", "moved")) > cases // 4


def test_the_other_way_round_the_same_differs(runs: list[LedgerRun]) -> None:
    for case, run in enumerate(runs):
        other = planted(run, 5, case).run
        there = [(one.kind, one.first_seq, one.second_seq) for one in align(run, other).differences]
        back = [
            (MIRROR.get(one.kind, one.kind), one.second_seq, one.first_seq) for one in align(other, run).differences
        ]
        assert sorted(there, key=str) == sorted(back, key=str)


def test_what_follows_from_what_is_missing_is_its_consequence(runs: list[LedgerRun]) -> None:
    run = runs[0]
    task = next(seq for seq, event in enumerate(run.events) if isinstance(event, TaskArrived))
    gone = {task}
    for seq, cause in enumerate(run.caused_by):
        if cause in gone:
            gone.add(seq)
    left = [seq for seq in range(len(run.events)) if seq not in gone]
    place = {seq: at for at, seq in enumerate(left)}
    without = LedgerRun(
        run.run_id,
        [run.times_us[seq] for seq in left],
        [None if run.caused_by[seq] is None else place[run.caused_by[seq]] for seq in left],  # type: ignore[index]
        [run.events[seq] for seq in left],
    )
    alone = [one for one in align(run, without).differences if one.kind == "only first"]
    assert {one.first_seq for one in alone} == gone
    assert [one.first_seq for one in alone if not one.is_consequence] == [task]


def test_a_chain_leads_from_an_event_to_a_fact_of_the_world(runs: list[LedgerRun]) -> None:
    run = runs[0]
    last = max(seq for seq, cause in enumerate(run.caused_by) if cause)
    seqs = chain(run, last)
    assert seqs[0] == last
    assert all(run.caused_by[one] == other for one, other in pairwise(seqs))
    assert run.caused_by[seqs[-1]] == 0
    assert chain(run, 0) == [0]


@pytest.mark.slow
def test_of_a_run_that_ends_before_all_has_happened_no_more_is_told_than_had_come_about(runs: list[LedgerRun]) -> None:
    late = 0
    for run in runs:
        ends_us = run.times_us[-1] // 3
        assert difference_of(run, until(run, ends_us), (), ends_us).differences == (), "what comes later is not missing"
        edited = planted(until(run, ends_us), 3, 1).run
        whole, ended = difference_of(run, edited, ()).consequences, difference_of(run, edited, (), ends_us).consequences
        assert whole is not None
        assert ended is not None
        assert {one.second for one in ended.metrics} == {None}
        assert [one.first for one in ended.metrics] == [one.first for one in whole.metrics]
        assert "open" not in {one.second for one in ended.tasks}
        assert ended.verdicts == [one for one in whole.verdicts if one.time_s <= ends_us / 1e6]
        late += len(whole.verdicts) - len(ended.verdicts)
    assert late, "some run has a verdict later than that"


@pytest.mark.slow
def test_what_a_run_does_not_observe_is_not_said_to_be_of_the_other_alone() -> None:
    run = simulated("cfc", 0)
    started = run.events[0]
    assert isinstance(started, RunStarted)
    blind = replace(started, kind="foreign", source="elsewhere", model_version=None, observes=("fleet", "execution"))
    events = [blind, *(one for one in run.events[1:] if isinstance(one, RobotJoined))]
    causes = [None, *([0] * (len(events) - 1))]
    silent = replace(run, events=events, times_us=[*run.times_us[: len(events)]], caused_by=causes)
    told = difference_of(run, silent, ())
    assert told.consequences is not None
    assert {one.verdict for one in told.consequences.verdicts} == {"policy violation", "authority conflict"}
    assert not any(one.is_judged_in_both for one in told.consequences.verdicts)
    text = "".join(diff_text(told, ("first", "second"), Screen()))
    assert "only first: policy violation" not in text
    assert "first: policy violation at " in text
    assert "; second does not observe what it rests on" in text
    nothing = replace(silent, events=events[:-1], times_us=silent.times_us[:-1], caused_by=causes[:-1])
    assert "no task is on record in either" in "".join(
        diff_text(difference_of(silent, nothing, ()), ("first", "second"), Screen())
    )


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (["drop absence:A1/0", "add absence:D1 20s for 5s"], SupervisorLeft | SupervisorReturned),
        (["drop encounter:A1/B1/0", "add encounter:A1/C1 20s"], PeersMet),
    ],
)
def test_facts_of_two_supervisors_or_pairs_are_two_and_none_has_changed(changes: list[str], what: type[Event]) -> None:
    base = base_of_record(simulated("fsar"), "0" * 64)
    fork = rerun(base).fork(parsed(changes)).record
    kinds = Counter(
        one.kind
        for one in align(base.record, fork).differences
        for seq, run in ((one.first_seq, base.record), (one.second_seq, fork))
        if seq is not None and isinstance(run.events[seq], what)
    )
    assert kinds == {kind: len(changes[1].split(" for ")) for kind in ("only first", "only second")}


def test_a_command_is_not_another_command_or_that_of_another_robot_changed() -> None:
    base = again(relay())
    leaves = '{"command": "LeaveFleet", "by": "robot/C1", "robot": "robot/C1"}'
    starts = '{"command": "ReportStart", "by": "robot/C1", "robot": "robot/C1", "action_id": "t/1.1"}'
    for dropped, added in (("JudgeRequest/0", leaves), ("ReportStart/0", starts)):
        fork = base.fork(parsed([f"drop command:{dropped}", f"add 2.5s {added}"])).record
        found = align(base.base.record, fork).differences
        assert not [one for one in found if {"command", "issued_by"} & {*one.fields}]


def test_a_task_is_due_after_its_budget_where_the_record_names_no_time(tmp_path: Path) -> None:
    for run, end in (("done", "TaskCompleted"), ("given up", "TaskAbandoned")):
        with fsar_ledger.record(
            tmp_path / "l", run=run, observes=["task"], epoch=datetime(2026, 3, 1, tzinfo=UTC)
        ) as one:
            at = datetime(2026, 3, 1, 0, 0, 2, tzinfo=UTC)
            one.event("TaskArrived", at=at, task_id="t", robot="robot/A", budget_us=10_000_000)
            one.event("TaskArrived", at=at, task_id="u", robot="robot/A")
            one.event(end, at=at, task_id="t")
    found = fsar_ledger.open_ledger(tmp_path / "l").diff(1, 2).consequences
    assert found is not None
    [budgeted, other] = found.tasks
    assert (budgeted.due_s, other.due_s) == (12.0, None)
