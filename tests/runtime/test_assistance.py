"""A helper's work is work: what stops it, and what recovery does then."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FailureCause, Robot, Subject, Supervisor
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceFailed,
    AssistanceRequested,
    RecoveryEscalated,
)
from fsar_ledger.events.world import ActuatorDegraded, Grade, ObstructionAppeared, RobotWentOff
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.cfc import process
from fsar_ledger.runtime.architectures.cfc.coordinator import ProcessWork
from fsar_ledger.runtime.architectures.cfc.execution import ReachHelper
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.recovery import AskPeers, ask_peers
from fsar_ledger.runtime.handlers.assistance import ordered
from fsar_ledger.runtime.handlers.commands import EndAssistance, StopAssistance
from tests import past
from tests.runtime.failures import ACTION, A, B, D, executing, failed
from tests.runtime.histories import happen, types
from tests.runtime.live import decided
from tests.sure import only

DOOR = "door.open.basic"
D_TOO = past.trusted(
    D, B, "session", decided_by=Supervisor("supervisor/D1"), reason=""
)  # D's body could help B as well


def helped(
    *before: Event, robot: Robot = B, capability: str = DOOR, cause: FailureCause = "obstruction"
) -> tuple[State, Robot]:
    """A failure with which a peer is helping now, and that peer."""
    state = failed(executing(robot, capability, *before), "peer", cause)
    made = decided(state, AskPeers(ACTION, 2_500_000, now_us=3_000_000))
    happen(state, *made)
    [admitted] = [event for event in made if isinstance(event, AssistanceAdmitted)]
    return state, admitted.helper


def ended(state: State, helper: Robot, answer: int = 1) -> tuple[Event, ...]:
    return decided(state, EndAssistance(ACTION, helper, 1, answer=answer))


def asked_again(state: State, now_us: int = 9_000_000) -> tuple[Event, ...]:
    """What comes of the question that follows help that failed."""
    apply(
        state,
        AssistanceFailed(
            subject=Subject("A1-1", ACTION),
            robot=state.execution.actions[ACTION].robot,
            helper=A,
            failure=1,
            cause="obstruction",
        ),
    )
    [again, last] = [
        one.command
        for react in FSAR.reacts[AssistanceFailed]
        for one in react(
            state,
            AssistanceFailed(subject=Subject("A1-1", ACTION), robot=B, helper=A, failure=1, cause="obstruction"),
            0,
        )
    ]
    assert isinstance(again, AskPeers)
    assert isinstance(last, AskPeers)
    assert last.is_last
    again.now_us = now_us
    return ask_peers(state, again)


def test_a_helper_with_a_clear_way_resolves_the_failure() -> None:
    state, helper = helped()
    assert types(ended(state, helper)) == ["AssistanceEnded", "FailureResolved"]
    assert decided(state, StopAssistance(ACTION, helper)) == ()


def test_what_is_in_the_way_of_the_helper_stops_it_at_once() -> None:
    state, helper = helped()
    apply(state, ObstructionAppeared(helper, "o"))
    for [found] in (decided(state, StopAssistance(ACTION, helper)), ended(state, helper)):
        assert isinstance(found, AssistanceFailed)
        assert (found.robot, found.helper, found.cause) == (B, A, "obstruction")


def test_an_actuator_that_stands_in_has_to_hold() -> None:
    grades: tuple[Grade, ...] = ("unreliable", "slipping", "lost")
    for grade in grades:
        state, helper = helped(robot=A, capability="carry.package", cause="degradation")
        assert helper == D
        apply(state, ActuatorDegraded(D, grade))
        found = only(AssistanceFailed, ended(state, D, answer=0))
        assert found.cause == "degradation"
        assert (types(ended(state, D)) == ["AssistanceEnded", "FailureResolved"]) == (grade == "unreliable")


def test_a_body_that_clears_a_way_needs_no_actuator() -> None:
    state, helper = helped()
    apply(state, ActuatorDegraded(helper, "lost"))
    assert types(ended(state, helper, answer=0)) == ["AssistanceEnded", "FailureResolved"]


def test_help_ends_once() -> None:
    state, helper = helped()
    apply(state, ended(state, helper)[0])
    assert ended(state, helper) == ()
    assert decided(state, StopAssistance(ACTION, helper)) == ()


def test_a_peer_that_could_not_help_is_not_asked_again() -> None:
    more = past.budget(B, "peer", 3)
    state, helper = helped(more)
    assert helper == A
    escalated = asked_again(state)[0]
    assert isinstance(escalated, RecoveryEscalated)
    assert (escalated.to_level, escalated.reason) == ("fleet", "no trusted peer")


def test_the_next_peer_is_asked_as_long_as_the_budget_lasts() -> None:
    more = past.budget(B, "peer", 3)
    requested, _ = asked_again(helped(more, D_TOO)[0])
    assert isinstance(requested, AssistanceRequested)
    assert (requested.helper, requested.since_us) == (D, 2_500_000)
    [late] = asked_again(helped(more, D_TOO)[0], now_us=2_500_000 + 30_000_001)
    [spent] = asked_again(helped(D_TOO)[0])  # one helper is what the level has
    for escalated in (late, spent):
        assert isinstance(escalated, RecoveryEscalated)
        assert (escalated.to_level, escalated.reason) == ("fleet", "budget exhausted")


def test_a_peer_that_does_not_answer_is_nobodys_help() -> None:
    state = failed(executing(B, DOOR), "peer")
    apply(state, RobotWentOff(A))
    assert decided(state, AskPeers(ACTION, 2_500_000, now_us=3_000_000)) == ()
    escalated, silent = decided(state, AskPeers(ACTION, 2_500_000, failure=1, is_last=True, now_us=8_000_000))[:2]
    assert silent == past.available(A, None, "offline", "no answer")
    assert isinstance(escalated, RecoveryEscalated)
    assert escalated.reason == "no trusted peer"


def test_a_helper_that_is_ordered_while_it_has_work_declines_for_itself() -> None:
    state = failed(executing(B, DOOR))
    happen(
        state,
        *process(state, ProcessWork(ACTION, "no help")),
        past.queued(Subject("A1-2", "A1-2/1.1"), A, A, "navigate.indoor"),
    )
    failure = state.execution.actions[ACTION], state.recovery[ACTION]
    declined = only(AssistanceDeclined, ordered(state, ReachHelper(ACTION, A), failure, "fleet"))
    assert (declined.robot, declined.helper) == (B, A)


def test_the_coordinator_sends_the_next_helper_and_then_calls() -> None:
    state = failed(executing(B, DOOR))
    sent: list[str] = []
    for _ in range(3):
        made = process(state, ProcessWork(ACTION, "no help"))
        happen(state, *made)
        sent += [event.helper for event in made if isinstance(event, AssistanceRequested)]
    assert (sent, types(made)) == ([A, D], ["RecoveryEscalated", "SupervisorCalled"])
