"""Override levels in whole runs: what is preempted goes on for its rest, and nothing is lost or doubled.

Paper: eq:override.
"""

from typing import Any

import msgspec
import pytest
from hypothesis import given as any_of
from hypothesis import settings
from hypothesis import strategies as st

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import OverrideLevel, Subject
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionFinished,
    ExecutionPaused,
    ExecutionPreempted,
    ExecutionQueued,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.request import RequestAccepted, RequestAdmitted, RequestClosed, RequestDenied
from fsar_ledger.events.task import TaskAbandoned
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import plain_rows
from fsar_ledger.metrics.library import library
from fsar_ledger.projections import execution
from fsar_ledger.projections.authority import LEVELS, rank
from fsar_ledger.projections.fold import apply, fold
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import StartAction, TakeTurn
from fsar_ledger.runtime.handlers.request import RequestCapability
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.world.schedule import schedule
from tests import past
from tests.recycled import from_table
from tests.runtime.histories import DOOR, A, B, C, D, types
from tests.runtime.live import of, play, played
from tests.runtime.pinned import PINNED
from tests.runtime.test_override import ASK, GRANT, OPEN, busy, urgent


def entry(name: str, level: OverrideLevel) -> ExecutionQueued:
    return past.queued(Subject("t", name), B, A, DOOR, override=level)


class Model:
    """The plain model: what the robot serves, what waits, and what of it was interrupted."""

    def __init__(self) -> None:
        self.serving: str | None = None
        self.waiting: list[tuple[str, OverrideLevel, bool]] = []  # name, level, was interrupted
        self.level: OverrideLevel = "none"

    def arrives(self, name: str, level: OverrideLevel) -> str | None:
        """The action that it interrupts, if it does."""
        if self.serving is None:
            self.serving, self.level = name, level
            return None
        if rank(level) >= 2 and rank(self.level) < rank(level):
            gone, self.waiting = self.serving, [(self.serving, self.level, True), *self.waiting]
            self.serving, self.level = name, level
            return gone
        ahead = [one for one in self.waiting if rank(one[1]) < rank(level) and not (one[2] and rank(level) < 2)]
        place = self.waiting.index(ahead[0]) if ahead else len(self.waiting)
        self.waiting.insert(place, (name, level, False))
        return None

    def ends(self) -> None:
        self.serving = None
        if self.waiting:
            self.serving, self.level, _ = self.waiting.pop(0)

    def leaves(self, place: int) -> str:
        return self.waiting.pop(place)[0]


@any_of(st.lists(st.tuples(st.integers(0, 5), st.sampled_from(LEVELS)), max_size=40))
@settings(max_examples=200, deadline=None)
def test_the_queue_is_that_of_a_plain_model_and_nothing_is_lost_or_doubled(
    moves: list[tuple[int, OverrideLevel]],
) -> None:
    state, model = execution.INITIAL, Model()
    alive: set[str] = set()
    for ordinal, (move, level) in enumerate(moves):
        if move <= 3 or model.serving is None:
            name = f"q{ordinal}"
            gone = model.arrives(name, level)
            if gone is not None:
                state = execution.evolve(state, ExecutionPreempted(Subject("t", gone), B, name, None))
            state = execution.evolve(state, entry(name, level))
            alive.add(name)
        elif move == 4 or not model.waiting:
            name = model.serving
            model.ends()
            state = execution.evolve(state, ExecutionFinished(Subject("t", name), past.parties(), B))
            alive.discard(name)
        else:
            name = model.leaves(ordinal % len(model.waiting))
            state = execution.evolve(state, ExecutionWithdrawn(Subject("t", name), B))
            alive.discard(name)
        assert state.current.get(B) == model.serving
        assert state.queues.get(B, ()) == tuple(name for name, _, _ in model.waiting)
        assert {model.serving, *(name for name, _, _ in model.waiting)} - {None} == alive


def lifetimes(events: list[tuple[int, Any]], action_id: str) -> tuple[list[int], int]:
    """When the action was planned to take how long, and how long it executed. Units: microseconds."""
    planned, executed, since = [], 0, None
    for time_us, event in events:
        if event.subject.action_id != action_id:
            continue
        if isinstance(event, ExecutionStarted | ExecutionResumed):
            if isinstance(event, ExecutionStarted):
                planned.append((event.ends_us or 0) - time_us)
            assert since is None, "started twice"
            since = time_us
        elif since is not None:
            executed, since = executed + time_us - since, None
    return planned, executed


STAGES = (ExecutionStarted, ExecutionResumed, ExecutionPreempted, ExecutionFinished)


def test_in_a_whole_run_the_preempted_action_goes_on_for_exactly_its_rest() -> None:
    alone = played([(1_000_000, ASK)], OPEN)
    [(began_us, began)] = of(alone, ExecutionStarted)
    run = played([(1_000_000, ASK), (began_us, urgent("hard-preempt"))], OPEN)
    kinds = [(type(event).__name__, event.subject.action_id) for _, event in of(run, *STAGES)]
    assert kinds == [
        ("ExecutionStarted", "q1"),
        ("ExecutionPreempted", "q1"),
        ("ExecutionStarted", "q2"),
        ("ExecutionFinished", "q2"),
        ("ExecutionResumed", "q1"),
        ("ExecutionFinished", "q1"),
    ]
    assert lifetimes(of(run, *STAGES), "q1") == ([began.ends_us - began_us], began.ends_us - began_us)
    assert len(of(run, RequestAccepted)) == len(of(run, RequestClosed)) == 2
    assert len(of(run, AuthorityClaimed)) == len(of(run, AuthorityReleased)) == 4
    assert run.state == fold(run.events)


def test_in_a_whole_run_what_was_interrupted_on_its_way_begins_once() -> None:
    [(on_the_way_us, _)] = of(played([(1_000_000, ASK)], OPEN), ApproachStarted)
    run = played([(1_000_000, ASK), (on_the_way_us, urgent("hard-preempt"))], OPEN)
    found = [type(event).__name__ for _, event in of(run, *STAGES) if event.subject.action_id == "q1"]
    assert found == ["ExecutionPreempted", "ExecutionStarted", "ExecutionFinished"]


def test_an_action_that_policy_holds_and_is_preempted_is_held_again_when_it_is_back() -> None:
    state = busy(stage="approaching")
    apply(state, past.ruled("deny", B, DOOR, "visit"))
    assert types(play(state, StartAction("q1", answer=5))) == ["ExecutionHeld"]
    assert "ExecutionPreempted" in types(play(state, urgent("hard-preempt"), EvaluateRequest("q2")))
    apply(state, past.finished(Subject("rounds", "q2"), B, C))
    assert types(play(state, TakeTurn("q1"), StartAction("q1", answer=5))) == ["ExecutionHeld"]


@any_of(st.lists(st.tuples(st.integers(0, 40_000_000), st.sampled_from(LEVELS), st.booleans()), min_size=1, max_size=7))
@settings(max_examples=60, deadline=None)
def test_in_any_run_every_request_is_executed_once_one_at_a_time(wanted: list[tuple[int, OverrideLevel, bool]]) -> None:
    commands = [
        (1_000_000 + time_us, RequestCapability(C if of_c else A, B, DOOR, "visit", f"q{number}", level))
        for number, (time_us, level, of_c) in enumerate(wanted)
    ]
    run = played(commands, OPEN, GRANT)
    history: list[tuple[int, Any]] = of(run, *STAGES)
    for _, command in commands:
        planned, executed = lifetimes(history, command.action_id)
        assert [executed] == planned
    assert sorted(event.subject.action_id for _, event in of(run, RequestClosed)) == sorted(
        command.action_id for _, command in commands
    )
    running: str | None = None
    for _, event in history:
        if isinstance(event, ExecutionStarted | ExecutionResumed):
            assert running is None, "two at once"
            running = event.subject.action_id
        elif event.subject.action_id == running:
            running = None
    assert (run.state.execution.current, run.state.authority.claims) == ({}, {})
    assert run.state == fold(run.events)


OFFERS = [
    msgspec.structs.replace(past.advertised(robot, capability), override_allowed="emergency-only")
    for robot, capability in ((A, "carry.package"), (B, DOOR), (D, "carry.heavy"))
]
PAIRS = ((C, B, DOOR), (A, B, DOOR), (D, A, "carry.package"), (A, D, "carry.heavy"))


def amid(seed: int) -> Kernel:
    """A whole scenario with its obstructions, windows, context changes and recoveries, and urgent requests all through
    it."""
    commands: list[tuple[int, Any]] = []
    for number in range(24):
        requester, executor, capability = PAIRS[(number + seed) % len(PAIRS)]
        level = LEVELS[(number * 7 + seed) % len(LEVELS)]
        commands.append(
            (
                4_000_000 + number * 4_700_000 + seed * 137_000,
                RequestCapability(requester, executor, capability, "visit", f"q{number}", level),
            )
        )
    return played(commands, *OFFERS, GRANT, facts=schedule(PINNED, seed, "fleet-contention", 0, 4))


def test_the_ten_invariants_hold_amid_urgent_requests() -> None:
    runs = [amid(seed) for seed in range(6)]
    records = [LedgerRun(f"amid-{seed}", run.times_us, run.caused_by, run.events) for seed, run in enumerate(runs)]
    names = [name for name in library().queries if name.startswith("invariants/")]
    with from_table(encode(records)) as database:
        assert {name: plain_rows(database.query(name)) for name in names} == {name: [] for name in names}
    assert len(names) == 10


@pytest.mark.parametrize("seed", range(12))
def test_amid_tasks_failures_and_changing_policy_nothing_is_lost_or_doubled(seed: int) -> None:
    run = amid(seed)
    preempted = [event.subject.action_id for _, event in of(run, ExecutionPreempted)]
    assert preempted
    admitted = [event.subject.action_id for _, event in of(run, RequestAdmitted)]
    finished = [event.subject.action_id for _, event in of(run, ExecutionFinished)]
    assert len(finished) == len(set(finished))
    withdrawn = {
        event.subject.action_id
        for _, event in of(run, ExecutionWithdrawn)
        if run.state.execution.actions[event.subject.action_id].stage == "withdrawn"
    }
    assert set(admitted) | set(preempted) <= set(finished) | withdrawn
    given_up = {event.task_id for _, event in of(run, TaskAbandoned)}
    assert {run.state.execution.actions[name].task_id for name in withdrawn} <= given_up
    assert {f"q{number}" for number in range(24)} <= {
        event.subject.action_id for _, event in of(run, RequestClosed, RequestDenied)
    }
    assert (run.state.execution.current, set(run.state.execution.actions)) == ({}, withdrawn)
    assert (run.state.authority.claims, run.state.task) == ({}, {})
    assert run.state == fold(run.events)
    moving: dict[str, str] = {}
    for _, event in of(run, *STAGES, ExecutionPaused, ExecutionFailed, ExecutionWithdrawn):
        robot, action_id = event.robot, event.subject.action_id
        if isinstance(event, ExecutionStarted | ExecutionResumed):
            assert robot not in moving, f"{robot} executes {moving.get(robot)} and {action_id}"
            moving[robot] = action_id
        elif moving.get(robot) == action_id:
            del moving[robot]
