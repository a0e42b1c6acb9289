"""A live run that lasts forgets what is over: no part of its state grows with what it has done."""

import itertools
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Robot
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.projections import fold, request
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.live import LiveRun, command_given, live_started
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.running import rss_kib

S = 1_000_000
A, B, C, D = (Robot(f"robot/{name}1") for name in "ABCD")
DOOR = "door.open.secure"
Given = tuple[str, str, dict[str, Any]]
"""A command: its name, who gives it, and what it says."""


def submitted(task: str, robot: Robot, *steps: str, **others: Any) -> Given:
    fields = {"robot": robot, "task_id": task, "steps": list(steps), "budget_us": 20 * S, **others}
    return "SubmitTask", robot, fields


def asked(action: str, context: str) -> Given:
    fields = {"requester": A, "executor": B, "capability": DOOR, "context": context, "action_id": action}
    return "RequestCapability", A, fields


def judged(action: str, accepts: bool) -> Given:
    return "JudgeRequest", B, {"robot": B, "action_id": action, "accepts": accepts}


def started(robot: Robot, action: str) -> Given:
    return "ReportStart", robot, {"robot": robot, "action_id": action}


def finished(robot: Robot, action: str) -> Given:
    return "ReportResult", robot, {"executor": robot, "action_id": action, "result": "success"}


def by_fleet(command: str, **fields: Any) -> Given:
    return command, FLEET_SUPERVISOR, fields


def answered(action: str, approves: bool = True) -> Given:
    return by_fleet("RespondToCall", supervisor=FLEET_SUPERVISOR, action_id=action, approves=approves)


WAIT: Given = ("", "", {})
"""A minute in which nobody says anything."""
BACK: tuple[Given, ...] = (
    ("ReportPresence", B, {"robot": B, "is_on": False}),
    ("ReportPresence", B, {"robot": B, "is_on": True}),
)
"""The door, which did not answer, can be asked again."""


def completed(task: str) -> Iterator[Given]:
    yield submitted(task, A, f"A {DOOR} B", budget_us=86_400 * S)
    yield judged(f"{task}/1.1", True)
    yield started(B, f"{task}/1.1")
    yield finished(B, f"{task}/1.1")


def denied(task: str) -> Iterator[Given]:
    yield submitted(task, A, f"A {DOOR} B")
    yield judged(f"{task}/1.1", False)
    yield WAIT


def unheard(task: str) -> Iterator[Given]:
    yield submitted(task, A, f"A {DOOR} B", budget_us=90 * S)
    yield from (WAIT, WAIT, WAIT, WAIT)


def never_begun(task: str) -> Iterator[Given]:
    """The door admits it, and never begins: the task is given up, and the action is withdrawn."""
    yield submitted(task, A, f"A {DOOR} B")
    yield judged(f"{task}/1.1", True)
    yield WAIT


def failed(task: str) -> Iterator[Given]:
    """All attempts and peers fail; a supervisor settles it."""
    action = f"{task}/1.1"
    yield from (submitted(task, A, f"A {DOOR} B", budget_us=900 * S), judged(action, True), started(B, action))
    yield "ReportFailure", B, {"robot": B, "action_id": action, "cause": "obstruction"}
    yield from [("ReportAttempt", B, {"robot": B, "action_id": action, "succeeded": False})] * 3
    yield from (WAIT, WAIT, WAIT, answered(action), finished(B, action))


def reviewed(task: str) -> Iterator[Given]:
    """A review that is approved, one that is not, and one that nobody answers."""
    yield by_fleet("SetSupervisionDensity", issued_by=FLEET_SUPERVISOR, robot=B, review_every=1, reason="a trial")
    for part, approves in (("a", True), ("b", False), ("c", None)):
        action = f"{task}{part}/1.1"
        yield from (submitted(f"{task}{part}", A, f"A {DOOR} B"), judged(action, True))
        if approves is not None:
            yield answered(action, approves)
        if approves:
            yield from (started(B, action), finished(B, action))
        yield from (WAIT, *BACK)
    yield by_fleet("SetSupervisionDensity", issued_by=FLEET_SUPERVISOR, robot=B, review_every=0, reason="no trial")


def for_itself(task: str) -> Iterator[Given]:
    """Requests of no step: one is executed, one is refused, one has no answer."""
    for number in range(3):
        yield asked(f"{task}-{number}", f"{task}-c")
        if number < 2:
            yield judged(f"{task}-{number}", not number)
        if not number:
            yield from (started(B, f"{task}-0"), finished(B, f"{task}-0"))
    yield from (WAIT, WAIT)


def governed(task: str) -> Iterator[Given]:
    """Trust, a right and a rule for this task alone."""
    yield submitted(task, A, f"A {DOOR} B")
    about = {"issued_by": FLEET_SUPERVISOR, "capability": DOOR, "context": task}
    yield by_fleet("SetTrust", robot=B, peer=A, scope="task", reason="for once", **about)
    yield by_fleet("SetPolicyRule", scope="fleet", robot=B, outcome="review", **about)
    yield by_fleet(
        "GrantAuthority", supervisor=FLEET_SUPERVISOR, requester=A, executor=B, override="none", context=task
    )
    yield from (judged(f"{task}/1.1", True), answered(f"{task}/1.1"), WAIT)


def competing(task: str) -> Iterator[Given]:
    """Two want the door, one of them soon; the supervisor lets one go first, and neither begins."""
    yield submitted(f"{task}a", A, f"A {DOOR} B")
    yield submitted(f"{task}c", C, f"C {DOOR} B", is_time_critical=True)
    yield from (judged(f"{task}a/1.1", True), answered(f"{task}a/1.1"), WAIT)


STORIES = (completed, denied, unheard, never_begun, failed, reviewed, for_itself, governed, competing)


class Shift:
    """A live run of four robots in which one story follows another."""

    def __init__(self) -> None:
        self.run = LiveRun(live_started(Constants(), 4, "2026-03-01T10:00:00Z"), Constants())
        self.now_us = 0
        self.said: Counter[str] = Counter()

    def play(self, *stories: Any) -> "Shift":
        for story in stories:
            for name, by, fields in (*story, *BACK):
                self.now_us += S
                if name:
                    self.said[self.run.give(self.now_us, command_given(name, by, fields)).rejected or ""] += 1
                else:
                    self.now_us += 60 * S
                    self.run.advance(self.now_us)
        return self

    @property
    def state(self) -> State:
        return self.run.kernel.state


def sizes(value: object, path: str = "") -> Iterator[tuple[str, int]]:
    """How many entries each collection of the state has, in all values under any key."""
    if isinstance(value, Mapping | tuple | frozenset):
        yield path, len(value)
        members = value.values() if isinstance(value, Mapping) else value
        for member in members:
            yield from sizes(member, f"{path}[]")
    elif isinstance(value, msgspec.Struct) and type(value).__module__.startswith("fsar_ledger.projections"):
        for name in value.__struct_fields__:
            yield from sizes(getattr(value, name), f"{path}.{name}")


def size_of(run: LiveRun) -> Counter[str]:
    found: Counter[str] = Counter({"pending": sum(1 for _ in run.kernel._pending)})
    for slot in State.__slots__:
        for path, size in sizes(getattr(run.kernel.state, slot), slot):
            found[path] += size
    return found


@pytest.fixture
def brief() -> Iterator[None]:
    """A live run forgets early."""
    with patch.multiple(fold, LATE=16, NAMES=64), patch.object(request, "MOST", 48):
        yield


def rounds(count: int, first: int = 0) -> Iterator[Iterator[Given]]:
    """Every story so many times, each time of other tasks."""
    return (story(f"{story.__name__}{number}") for number in range(first, first + count) for story in STORIES)


def most(shift: Shift, first: int, count: int) -> Counter[str]:
    """The most entries that each collection has while so many rounds are played."""
    found: Counter[str] = Counter()
    for story in rounds(count, first):
        found |= size_of(shift.play(story).run)
    return found


@pytest.mark.slow
def test_no_collection_of_the_state_grows_with_what_the_run_has_done(brief: None) -> None:
    shift = Shift()
    shift.play(*rounds(25))
    before = most(shift, 25, 12)
    shift.play(*rounds(25, 37))
    after = most(shift, 62, 12)
    assert before["request.open"] > 10
    assert {name: (before[name], size) for name, size in after.items() if size > before[name] * 1.2 + 2} == {}


@pytest.mark.slow
def test_the_state_grows_where_nothing_is_forgotten() -> None:
    """The test above finds what it should."""
    shift = Shift()
    grown = {name for name, size in most(shift, 0, 12).items() if size > 11}
    for name in ("context", "request.open", "execution.actions", "supervision.calls", "authority.approvals", "pending"):
        assert name in grown


def test_a_run_that_forgets_decides_as_one_that_does_not_and_is_made_again_by_its_commands(brief: None) -> None:
    forgetful, other = Shift(), Shift()
    forgetful.play(*rounds(12))
    with patch.multiple(fold, LATE=1 << 10, NAMES=1 << 16), patch.object(request, "MOST", 1 << 11):
        other.play(*rounds(12))
    kernel = forgetful.run.kernel
    assert (kernel.events, kernel.times_us) == (other.run.kernel.events, other.run.kernel.times_us)
    assert len(forgetful.state.context) < len(other.state.context)
    assert len(forgetful.state.request.open) < len(other.state.request.open)
    assert replay_run(LedgerRun("hall", kernel.times_us, kernel.caused_by, kernel.events)) is None
    assert fold.fold(kernel.events) == forgetful.state


def test_a_simulated_run_forgets_nothing() -> None:
    run = simulate_run(RunSpec(8, "fsar", "full", "door-relay", 4, 0), Constants())
    ended = [event.task_id for event in run.events if isinstance(event, TaskCompleted | TaskAbandoned)]
    assert len(ended) > 1
    with patch.multiple(fold, LATE=1, NAMES=1):
        assert [*fold.fold(run.events).context] == ended


def taken(shift: Shift, command: Given) -> bool:
    """Whether a name in the command was used."""
    shift.now_us += S
    name, by, fields = command
    return "is taken" in (shift.run.give(shift.now_us, command_given(name, by, fields)).rejected or "")


def test_names_of_what_is_forgotten_are_not_used_again(brief: None) -> None:
    shift = Shift().play(for_itself("own"), (asked("t9/2.1", "elsewhere"), WAIT, WAIT), completed("first"))
    shift.play(*(for_itself(f"o{number}") for number in range(4)), *(denied(f"d{number}") for number in range(40)))
    assert not {"own-0", "t9/2.1"} & shift.state.request.open.keys()
    assert taken(shift, submitted("first", A, f"A {DOOR} B"))
    assert taken(shift, asked("own-0", "else"))
    assert taken(shift, submitted("t9", A, f"A {DOOR} B"))
    assert taken(shift, submitted("own-c", A, f"A {DOOR} B"))


@pytest.mark.slow
def test_a_name_that_was_forgotten_too_is_a_new_one_and_an_old_timer_does_not_end_its_task(brief: None) -> None:
    shift = Shift().play(completed("first"))
    with patch("fsar_ledger.runtime.kernel.is_idle", return_value=False):  # the timer of the first stays
        shift.play(*(denied(f"d{number}") for number in range(100)))
    assert "first" not in shift.state.context
    assert not taken(shift, submitted("first", A, f"A {DOOR} B", budget_us=90_000 * S))
    shift.now_us = 2 * 86_400 * S
    shift.run.advance(shift.now_us)
    assert "first" in shift.state.task
    shift.now_us += 4 * 90_000 * S
    shift.run.advance(shift.now_us)
    assert "first" not in shift.state.task


TASKS = int(os.environ.get("TASKS", "200000"))
TEAMS = 20


def played(task: str, team: int, is_denied: bool) -> Iterator[Given]:
    """A task of this team, in the same four commands each time."""
    requester, door, action = Robot(f"robot/A{team}"), Robot(f"robot/B{team}"), f"{task}/1.1"
    yield submitted(task, requester, f"A {DOOR} B", budget_us=S if is_denied else 86_400 * S)
    yield "JudgeRequest", door, {"robot": door, "action_id": action, "accepts": not is_denied}
    yield started(door, action)
    yield finished(door, action)


@pytest.mark.soak
def test_the_last_thousand_tasks_take_no_longer_than_the_first_and_memory_is_flat(tmp_path: Path) -> None:
    """Twenty teams play at once; one of twenty tasks is denied, and given up."""
    now_us = itertools.count(1_772_359_200_000_000, 1_000)
    spent, used = [], []
    with fsar_ledger.federate(
        tmp_path / "ledger", run="day", robots=4 * TEAMS, clock=lambda: next(now_us) * 1_000
    ) as one:
        for thousand in range(TASKS // 1_000):
            begun = time.process_time()
            for first in range(1_000 * thousand, 1_000 * (thousand + 1), TEAMS):
                stories = [played(f"t{first + n}", n + 1, n == first // TEAMS % TEAMS) for n in range(TEAMS)]
                for said in zip(*stories, strict=True):
                    one.decide_all([command_given(name, by, fields) for name, by, fields in said])
            spent.append(time.process_time() - begun)
            used.append(rss_kib() / 1024)
            print(f"{thousand + 1:4} {spent[-1]:.3f} s {used[-1]:.0f} MiB", flush=True)
        assert len(one.state.task) < 200
    assert median(spent[-5:]) <= 1.2 * median(spent[:5])  # a snapshot takes a tenth of a second now and then
    assert used[-1] - used[len(used) // 2] < 32
