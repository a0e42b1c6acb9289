"""ALLIANCE: what comes too early or too late for a robot that has left an action, and come back to it."""

import msgspec

from fsar_ledger.designs.constants import Range
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionQueued,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.knowledge import ActivityBroadcast
from fsar_ledger.events.recovery import RecoveryAttempted
from fsar_ledger.events.task import TaskAbandoned
from fsar_ledger.events.world import ObstructionAppeared
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.alliance import ALLIANCE, EndTry, StartWork, TryAgain
from fsar_ledger.runtime.handlers.commands import ResumeAction
from tests import past
from tests.runtime.architectures.test_alliance import (
    ACTION,
    CLOSED,
    DIALS,
    DOOR,
    FAR,
    LONG,
    WORLD,
    A,
    B,
    S,
    opened,
    ran,
)
from tests.runtime.histories import given
from tests.runtime.live import decided, when

STEP = Subject("A1-1", ACTION)
PARTIES = past.parties(executed_by=B)
QUEUED = ExecutionQueued(
    subject=STEP,
    principals=PARTIES,
    robot=B,
    on_behalf_of=A,
    capability=DOOR,
    step=1,
    attempt=1,
    is_delegated=True,
    has_approach=True,
    is_supervised=False,
)
STARTED = ExecutionStarted(subject=STEP, principals=PARTIES, robot=B, on_behalf_of=A, capability=DOOR, ends_us=9 * S)
FAILED = ExecutionFailed(subject=STEP, robot=B, failure=2, cause="obstruction", remaining_us=S, detected_us=3 * S)
BEGUN = past.began(STEP, A, 1, DOOR, "B")


def active(*events: Event) -> State:
    """The robot has been active since second 2, and this has happened since."""
    return given("alliance", FAR, BEGUN, ActivityBroadcast(STEP, B, 2 * S), QUEUED, *events)


def test_an_arrival_counts_for_the_activity_in_which_the_robot_set_out() -> None:
    state = active(ApproachStarted(STEP, B))
    assert decided(state, StartWork(ACTION, robot=B, since_us=2 * S), ALLIANCE)
    assert not decided(state, StartWork(ACTION, robot=B, since_us=S), ALLIANCE)
    assert not decided(state, StartWork(ACTION, robot=Robot("robot/B2"), since_us=2 * S), ALLIANCE)


def test_a_robot_does_not_go_on_with_what_has_failed_until_it_has_recovered() -> None:
    failed = active(STARTED, FAILED)
    assert not decided(failed, ResumeAction(ACTION), ALLIANCE)


def test_an_attempt_counts_for_the_failure_for_which_it_was_made() -> None:
    failed = active(STARTED, FAILED)
    [attempted] = decided(failed, TryAgain(ACTION, 2), ALLIANCE)
    assert isinstance(attempted, RecoveryAttempted)
    assert attempted.deadline_us == 2 * S + DIALS.give_up_us
    assert not decided(failed, TryAgain(ACTION, 1), ALLIANCE)
    trying = active(STARTED, FAILED, attempted)
    assert decided(trying, EndTry(ACTION, 1, failure=2), ALLIANCE)
    assert not decided(trying, EndTry(ACTION, 1, failure=1), ALLIANCE)
    assert not decided(trying, EndTry(ACTION, 2, failure=2), ALLIANCE)


def test_a_robot_that_has_left_a_failed_action_tries_no_more() -> None:
    left = active(STARTED, FAILED, ExecutionWithdrawn(STEP, B))
    assert not decided(left, TryAgain(ACTION, 2), ALLIANCE)
    assert not decided(left, EndTry(ACTION, 0, failure=2), ALLIANCE)


def test_a_window_of_its_policy_does_not_make_a_robot_yield_early() -> None:
    run = ran([(S, FAR), (6 * S, opened(B)), (7 * S, CLOSED)], LONG)
    begun = min(when(run, AuthorityClaimed, claimant=B))
    assert min(when(run, ExecutionWithdrawn, robot=B)) == begun + DIALS.yield_us + 1


def test_a_second_way_to_an_action_is_another_way() -> None:
    world = msgspec.structs.replace(WORLD, approach=Range(3.0, 8.0))
    facts = [(S, FAR), (4 * S, opened(B)), (8 * S, CLOSED)]
    plain, turned = ran([(S, FAR)], world, 4), ran(facts, world, 4)
    ways = [
        when(run, ExecutionStarted, robot=B)[-1] - when(run, ApproachStarted, robot=B)[-1] for run in (plain, turned)
    ]
    assert ways[0] != ways[1]


def test_a_need_of_a_task_that_is_given_up_is_forgotten_and_not_pursued() -> None:
    soon = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=10 * S, due_us=11 * S)
    for hindrance in (ObstructionAppeared(B, "cart"), opened(B)):
        run = ran([(S, soon), (2 * S, hindrance), (60 * S, CLOSED)], size=4)
        [given_up] = when(run, TaskAbandoned)
        assert not run.state.motivation.of
        assert not run.state.authority.claims
        assert max(when(run, AuthorityClaimed, claimant=B), default=0) < given_up
