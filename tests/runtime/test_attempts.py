"""A step is tried again after an attempt that came to nothing: once, and not while a later attempt is under way."""

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Architecture, RequestSubject, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.request import (
    OfferAnswered,
    PeerSought,
    RequestClosed,
    RequestDenied,
    RequestIssued,
    RequestUnanswered,
)
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskCompleted
from fsar_ledger.events.world import PolicyWindowClosed
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.dhma import DHMA
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.request import AdmitReviewed, EvaluateRequest
from fsar_ledger.runtime.handlers.commands import BeginStep, Command, StartAction, TakeTurn
from fsar_ledger.runtime.handlers.request import ReportResult, RequestCapability
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from tests import past
from tests.runtime.histories import given, happen, types, window
from tests.runtime.live import decided

A, B, DOOR, H_F = Robot("robot/A1"), Robot("robot/B1"), "door.open.secure", Supervisor("supervisor/fleet")
ARRIVED = past.arrived("A1-1", A, (f"A {DOOR} B", "A navigate.indoor"), due_us=61_000_000)
FIRST, SECOND = "A1-1/1.1", "A1-1/1.2"
SUBJECT = RequestSubject("A1-1", FIRST, FIRST)
PARTIES = past.parties(A, B)


def began(action_id: str, attempt: int = 1, target: str | None = "B") -> StepBegan:
    return StepBegan(
        subject=Subject("A1-1", action_id), robot=A, step=1, attempt=attempt, capability=DOOR, target_role=target
    )


def asked() -> State:
    """A's first request for B's door is on its way."""
    shown = past.queried(Subject("A1-1", FIRST), past.parties(A, B), DOOR, B)
    issued = RequestIssued(subject=SUBJECT, principals=PARTIES.decided(A), capability=DOOR, carried_policy="allow")
    return given("fsar", ARRIVED, began(FIRST), shown, issued)


def given_to(state: State, command: Command) -> list[str]:
    """The types of what the command makes, all of it taken in."""
    events = decided(state, command)
    happen(state, *events)
    return types(events)


def begins(table: HandlerTable, state: State, event: Event) -> list[BeginStep]:
    """The orders to turn to a step that follow the event, which the state takes in."""
    apply(state, event)
    scheduled = [one.command for react in table.reacts.get(type(event), ()) for one in react(state, event, 0)]
    return [command for command in scheduled if isinstance(command, BeginStep)]


# A refusal is the last word about a request


def test_a_request_that_was_refused_is_not_judged_again_even_once_the_reason_is_gone() -> None:
    state = asked()
    apply(state, window(B))
    assert given_to(state, EvaluateRequest(FIRST)) == ["RequestDenied"]
    assert given_to(state, EvaluateRequest(FIRST)) == []
    apply(state, PolicyWindowClosed(B, "local", "local/B1/0"))
    assert given_to(state, EvaluateRequest(FIRST)) == []


def test_a_disapproval_and_a_second_one_of_the_same_request_refuse_it_once() -> None:
    """The executor judges again between H_F's answer and word of it, and calls H_F anew."""
    state = asked()
    apply(state, window(B, "review"))
    assert given_to(state, EvaluateRequest(FIRST)) == ["SupervisorCalled"]
    assert given_to(state, RespondToCall(H_F, FIRST, False)) == ["SupervisorResponded"]
    assert given_to(state, EvaluateRequest(FIRST)) == ["SupervisorCalled"]
    assert given_to(state, AdmitReviewed(FIRST, False)) == ["RequestDenied"]
    assert given_to(state, RespondToCall(H_F, FIRST, False)) == ["SupervisorResponded"]
    assert given_to(state, AdmitReviewed(FIRST, False)) == []


def test_an_approval_that_comes_after_the_refusal_admits_nothing() -> None:
    state = asked()
    apply(state, window(B, "review"))
    given_to(state, EvaluateRequest(FIRST))
    given_to(state, RespondToCall(H_F, FIRST, True))
    denial = window(B)
    apply(state, denial)
    assert given_to(state, EvaluateRequest(FIRST)) == ["RequestDenied"]
    apply(state, PolicyWindowClosed(B, "local", denial.window))
    assert given_to(state, AdmitReviewed(FIRST, True)) == []


@pytest.mark.parametrize("command", [EvaluateRequest(FIRST), AdmitReviewed(FIRST)])
def test_a_request_that_was_executed_is_not_admitted_again_before_it_is_closed(command: Command) -> None:
    """Word of H_F's order comes when the execution is over and its result is still on the way back."""
    state = asked()
    assert given_to(state, EvaluateRequest(FIRST)) == ["RequestAdmitted", "ExecutionQueued"]
    given_to(state, TakeTurn(FIRST))
    assert given_to(state, StartAction(FIRST, answer=5)) == ["ExecutionStarted"]
    assert given_to(state, ReportResult(B, FIRST, "success")) == ["ExecutionFinished"]
    assert given_to(state, command) == []


def test_nobody_asks_in_the_service_of_a_request_that_was_refused() -> None:
    state = asked()
    apply(state, RequestDenied(SUBJECT, PARTIES.decided(B), "policy"))
    [refused] = decided(state, RequestCapability(B, A, "carry.package", "visit", "q1", parent=FIRST))
    assert f"the parent {FIRST} is over" in refused.reason  # type: ignore[attr-defined]


# Which attempt the next one follows


@pytest.mark.parametrize(
    "event",
    [
        RequestDenied(SUBJECT, PARTIES.decided(B), "policy"),
        RequestUnanswered(Subject("A1-1", FIRST), past.principals(A, A), DOOR),
        PeerSought(Subject("A1-1", FIRST), A),
        OfferAnswered(SUBJECT, PARTIES.decided(A), 1, False, None),
        RequestClosed(SUBJECT, PARTIES.decided(B), "failure"),
        RequestClosed(SUBJECT, PARTIES.decided(B), "partial"),
    ],
    ids=lambda event: type(event).__name__,
)
def test_the_next_attempt_follows_the_one_that_came_to_nothing(event: Event) -> None:
    assert begins(FSAR, asked(), event) == [BeginStep("A1-1", FIRST)]


def test_an_own_step_that_failed_is_followed_by_its_next_attempt() -> None:
    state = given("fsar", ARRIVED, began(FIRST, target=None))
    assert begins(FSAR, state, ExecutionFinished(Subject("A1-1", FIRST), past.parties(A, A), A, "failure")) == [
        BeginStep("A1-1", FIRST)
    ]


def test_in_dhma_the_next_attempt_follows_the_refused_own_step_and_the_call_without_a_good_bid() -> None:
    own = given("dhma", ARRIVED, began(FIRST, target=None))
    assert begins(
        DHMA, own, RequestDenied(RequestSubject("A1-1", FIRST, None), past.principals(A, A, A), "own step")
    ) == [BeginStep("A1-1", FIRST)]
    called = given("dhma", ARRIVED, began(FIRST), past.queried(Subject("A1-1", FIRST), past.parties(A), DOOR, B))
    assert begins(DHMA, called, BidReceived(Subject("A1-1", FIRST), B, "deny")) == [BeginStep("A1-1", FIRST)]


def test_a_new_task_and_a_finished_step_are_followed_by_no_attempt_in_particular() -> None:
    assert begins(FSAR, given("fsar"), ARRIVED) == [BeginStep("A1-1", "")]
    assert begins(FSAR, given("fsar", ARRIVED, began(FIRST)), StepCompleted(Subject("A1-1", FIRST))) == [
        BeginStep("A1-1", "", step=1)
    ]


# What an order to turn to a step finds


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma"])
def test_a_step_begins_anew_after_its_last_attempt(architecture: Architecture) -> None:
    state = given(architecture, ARRIVED, began(FIRST))
    assert decided(state, BeginStep("A1-1", FIRST)) == (began(SECOND, 2),)


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma"])
@pytest.mark.parametrize("after", [FIRST, ""])
def test_a_step_does_not_begin_anew_while_a_later_attempt_is_under_way(architecture: Architecture, after: str) -> None:
    state = given(architecture, ARRIVED, began(FIRST), began(SECOND, 2))
    assert decided(state, BeginStep("A1-1", after)) == ()


def test_an_attempt_that_the_task_has_left_behind_neither_begins_the_next_step_nor_ends_the_task() -> None:
    state = given("fsar", ARRIVED, began(FIRST), StepCompleted(Subject("A1-1", FIRST)))
    assert decided(state, BeginStep("A1-1", FIRST)) == ()
    assert decided(state, BeginStep("A1-1", FIRST, now_us=10**9)) == ()
    assert types(decided(state, BeginStep("A1-1"))) == ["StepBegan"]
    apply(state, past.began(Subject("A1-1", "A1-1/2.1"), A, 2, "navigate.indoor"))
    apply(state, StepCompleted(Subject("A1-1", "A1-1/2.1")))
    assert decided(state, BeginStep("A1-1", "A1-1/2.1")) == ()
    assert decided(state, BeginStep("A1-1")) == (TaskCompleted("A1-1"),)
