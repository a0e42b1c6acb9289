"""What held from when to when: spans say the same as the state."""

import random
from collections.abc import Container
from typing import Any

import pytest
from msgspec.structs import replace

from fsar_ledger.analysis.moments import Timeline
from fsar_ledger.analysis.situation import situation
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import from_table
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import RequestEnds
from fsar_ledger.view.spans import FACTS, TRACKS, Fact, Span, call_facts, lane_of, request_facts, spans_of
from tests import past
from tests.foreign.histories import foreign_run
from tests.view.conftest import a_run

FOREIGN = RunStarted(kind="foreign", observes=("execution", "policy"), source="example.org")
A1, B1 = Robot("robot/A1"), Robot("robot/B1")


def held(spans: tuple[Span, ...], seq: int) -> set[Fact]:
    """The facts that hold just after this event."""
    return {span.fact for span in spans if span.seq <= seq and (span.until is None or seq < span.until)}


def test_at_every_event_exactly_the_facts_of_the_state_hold(runs: dict[str, LedgerRun]) -> None:
    for run in runs.values():
        found = spans_of(run)
        of_state = tuple(span for span in found if span.fact.kind != "offline" and span.fact.lane != "coordinator")
        state = State()
        for seq, event in enumerate(run.events):
            apply(state, event)
            facts = {fact for slot, read in FACTS.items() for fact in read(getattr(state, slot))}
            facts |= {*request_facts(one for one in state.request.open.values() if not one.is_over)}
            facts |= {*call_facts(state)}
            assert held(of_state, seq) == {fact for fact in facts if fact.lane != "coordinator"}, seq


@pytest.mark.parametrize("seed", range(12))
def test_at_every_event_of_another_systems_run_its_open_requests_hold(seed: int) -> None:
    observes = ("task", "request", "execution", "world") if seed % 2 else ("task", "execution", "world")
    run = foreign_run("r", 600, random.Random(seed), observes)
    began = RunStarted(kind="foreign", observes=observes, records=("RequestIssued", "RequestAccepted"), source="s")
    run = replace(run, events=(began, *run.events[1:]))
    found = tuple(span for span in spans_of(run) if span.fact.track == "request")
    assert found
    state, ends = State(), RequestEnds()
    for seq, event in enumerate(run.events):
        apply(state, event)
        ends = ends.after(event)
        actions = state.execution.actions
        still = request_facts(one for one in state.request.open.values() if not ends.is_over(one, actions))
        assert held(found, seq) == {*still}, seq


def test_a_request_is_over_with_its_task_until_it_is_issued_again() -> None:
    issued, completed = past.issued("q", past.principals(A1, A1, B1), "lift"), TaskCompleted(task_id="t1")
    state, ends = State(), RequestEnds().after(replace(FOREIGN, observes=("task",)))
    found = []
    for event in (issued, TaskCompleted(task_id="t2"), completed, issued, completed):
        apply(state, event)
        ends = ends.after(event)
        found.append(ends.is_over(state.request.open["q"], ()))
    assert found == [False, False, True, False, True]


def test_what_is_over_is_not_looked_at_again_with_every_event(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[str] = []
    is_over = RequestEnds.is_over

    def counted(ends: RequestEnds, request: Request, in_hand: Container[str]) -> bool:
        looks.append(request.action_id)
        return is_over(ends, request, in_hand)

    monkeypatch.setattr(RequestEnds, "is_over", counted)
    asked = [
        event
        for number in range(300)
        for event in (
            past.issued(f"q{number}", past.principals(A1, A1, B1), "lift", f"t{number}"),
            TaskCompleted(task_id=f"t{number}"),
        )
    ]
    source = replace(FOREIGN, observes=("task",), records=("RequestIssued",))
    run = LedgerRun("r", tuple(range(601)), (None, *[0] * 600), (source, *asked))
    assert len([one for one in spans_of(run) if one.fact.track == "request"]) == 300
    assert len(looks) < 3 * len(run.events)


def test_an_execution_is_a_span_from_its_start_to_its_end(runs: dict[str, LedgerRun]) -> None:
    run = runs["fsar"]
    spans = [span for span in spans_of(run) if span.fact.track == "work"]
    finished = [seq for seq, event in enumerate(run.events) if isinstance(event, ExecutionFinished)]
    assert finished
    for seq in finished:
        event = run.events[seq]
        assert isinstance(event, ExecutionFinished)
        (last,) = (span for span in spans if span.until == seq and span.fact.about == event.subject.action_id)
        assert (last.fact.lane, last.fact.kind, last.end_us) == (event.robot, "running", run.times_us[seq])


def test_every_track_is_used_somewhere() -> None:
    runs = [a_run(architecture, number=number) for architecture in ("fsar", "cfc") for number in range(8)]
    tracks = {span.fact.track for run in runs for span in spans_of(run)}
    assert tracks == set(TRACKS)


def test_agents_share_the_lane_of_their_robot() -> None:
    assert lane_of("agent/A1/planning") == "robot/A1"
    assert lane_of("supervisor/A1") == "supervisor/A1"


def test_what_is_open_at_the_end_has_no_end() -> None:
    opened = PolicyWindowOpened(robot=B1, scope="local", window="local/B1/0", outcome="deny")
    (span,) = spans_of(LedgerRun("r", (0, 5), (None, 0), (FOREIGN, opened)))
    assert span == Span(Fact(B1, "policy", "deny", "local/B1/0", "local policy: deny"), 5, None, 1, None)


def test_a_rule_that_does_not_allow_is_a_span_for_each_robot_for_which_it_stands() -> None:
    joined = (past.joined(one, "porter", domain="ward") for one in (A1, B1))
    every: dict[str, Any] = {"capability": None, "context": None, "decided_by": None}
    door = {**every, "capability": "door.open"}
    rules = (
        PolicyRuleSet(scope="fleet", robot=None, outcome="review", **door),
        RolePolicyRuleSet(scope="local", role="porter", outcome="deny", domain="ward", **every),
        PolicyRuleSet(scope="local", robot=B1, outcome="review", **every),
        RolePolicyRuleSet(scope="local", role="porter", outcome="allow", domain="", **every),
        PolicyRuleSet(scope="fleet", robot=None, outcome="allow", **door),
        PolicyRuleSet(scope="local", robot=A1, outcome="deny", **{**door, "context": "t1"}),
    )
    events = (replace(FOREIGN, observes=("fleet", "policy")), *joined, *rules)
    run = LedgerRun("r", tuple(range(len(events))), (None, *range(len(events) - 1)), events)
    drawn = [one for one in spans_of(run) if one.fact.track == "policy"]
    with from_table(encode([run])) as database:
        windows = database.rows("SELECT robot, scope, outcome, opened_us, closed_us FROM policy_windows")
    told = [(one.fact.lane, one.fact.text, one.start_us, one.end_us) for one in drawn]
    assert sorted(told, key=str) == sorted(
        (
            (row["robot"], f"{row['scope']} rule: {row['outcome']}", row["opened_us"], row["closed_us"])
            for row in windows
        ),
        key=str,
    )
    assert len(told) == 6
    assert {one.fact.about for one in drawn} == {"door.open", "every capability", "door.open in t1"}


def test_availability_holds_until_the_registry_learns_another() -> None:
    off = past.available(B1, None, "offline", "no answer")
    on = replace(off, availability="ready")
    (span,) = spans_of(LedgerRun("r", (0, 5, 9), (None, 0, 1), (FOREIGN, off, on)))
    assert (span.fact.kind, span.start_us, span.end_us) == ("offline", 5, 9)


def test_what_begins_without_having_been_queued_is_what_the_robot_does_then() -> None:
    """Another system may record that something began, and never that it was queued."""
    parties = past.parties()
    queued = ExecutionQueued(
        subject=Subject("t", "t/1"),
        principals=parties,
        robot=B1,
        on_behalf_of=B1,
        capability="lift",
        step=1,
        attempt=1,
        is_delegated=False,
        has_approach=False,
        is_supervised=False,
    )
    began = past.started(Subject("t", "t/2"), B1, B1, "lift", 9, parties)
    opened = PolicyWindowOpened(robot=B1, scope="fleet", window="fleet/B1/0", outcome="review")
    found = spans_of(LedgerRun("r", (0, 1, 3, 5), (None, 0, 0, 0), (FOREIGN, queued, began, opened)))
    assert [(span.fact.track, span.fact.kind, span.fact.about, span.start_us, span.end_us) for span in found] == [
        ("work", "queued", "t/1", 1, 3),
        ("queue", "waiting", "t/1", 3, None),
        ("work", "running", "t/2", 3, None),
        ("policy", "review", "fleet/B1/0", 5, None),
    ]


def test_a_robot_is_drawn_at_work_only_where_the_source_records_how_executions_end() -> None:
    began = [past.started(Subject("t", f"t/{number}"), B1, B1, "lift", 9, past.parties()) for number in (1, 2)]
    ends = ("ExecutionFinished", "ExecutionWithdrawn")
    for records, drawn in (((), []), (ends, [("running", "t/1", 1, None), ("running", "t/2", 5, None)])):
        source = replace(FOREIGN, observes=(), records=("ExecutionStarted", *records))
        run = LedgerRun("r", (0, 1, 5), (None, 0, 0), (source, *began))
        spans = [(span.fact.kind, span.fact.about, span.start_us, span.end_us) for span in spans_of(run)]
        assert spans == drawn
        (robot,) = situation(Timeline(run).past(2), {}, None).robots or ()
        assert (bool(robot.work), robot.queue) == (bool(drawn), None)
