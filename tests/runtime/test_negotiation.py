"""Negotiated requests and their results: given events, when a command, then events."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityReleased
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import OverrideLevel, Subject
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import OfferAnswered, RequestAdmitted, RequestClosed, RequestCountered, RequestDenied
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskCompleted
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import Command, TakeTurn
from fsar_ledger.runtime.handlers.request import AnswerOffer, ReportResult
from tests import past
from tests.runtime.histories import ARRIVED, DOOR, A, B, D, happen, types
from tests.runtime.live import decided, of, played
from tests.runtime.test_requests import ASK, asked, offered, served
from tests.sure import only


def countered(level: OverrideLevel = "hard-preempt", allowed: OverrideLevel = "soft-priority", *before: Event) -> State:
    command = msgspec.structs.replace(ASK, override=level)
    return served(asked(offered(allowed), *before, command=command), EvaluateRequest("q1"))


def test_an_executor_asked_for_more_override_than_it_allows_offers_what_it_allows() -> None:
    state = asked(offered("soft-priority"), command=msgspec.structs.replace(ASK, override="hard-preempt"))
    counter = only(RequestCountered, decided(state, EvaluateRequest("q1")))
    assert (counter.round, counter.override, counter.principals.decided_by) == (1, "soft-priority", "robot/B1")
    apply(state, counter)
    assert decided(state, EvaluateRequest("q1")) == (), "it waits for the answer"


def test_a_grant_of_less_than_the_executor_allows_is_the_limit() -> None:
    grant = past.granted(A, B, "soft-priority", DOOR)
    assert countered("hard-preempt", "hard-preempt", grant).request.open["q1"].offered == "soft-priority"


def test_a_taken_offer_admits_the_request_on_those_terms() -> None:
    state = countered()
    answer = only(OfferAnswered, decided(state, AnswerOffer(A, "q1", True)))
    assert (answer.round, answer.is_accepted, answer.override) == (1, True, "soft-priority")
    apply(state, answer)
    admitted, queued = decided(state, EvaluateRequest("q1"))
    assert isinstance(admitted, RequestAdmitted)
    assert isinstance(queued, ExecutionQueued)
    assert (admitted.override, queued.override) == ("soft-priority", "soft-priority")


def test_a_negotiation_ends_after_so_many_rounds() -> None:
    state = countered()
    rounds = state.fleet.structure.negotiation_rounds
    for number in range(1, rounds + 1):
        assert (state.request.open["q1"].offers, state.request.open["q1"].offered) == (number, "soft-priority")
        state = served(state, AnswerOffer(A, "q1", False, "hard-preempt"))
        events = decided(state, EvaluateRequest("q1"))
        happen(state, *events)
    denied = only(RequestDenied, events)
    assert denied.reason == "negotiation"


def test_a_requester_that_lets_go_ends_its_request() -> None:
    state = served(countered(), AnswerOffer(A, "q1", False))
    assert state.request.open["q1"].is_over
    assert decided(state, EvaluateRequest("q1")) == ()


@pytest.mark.parametrize(
    ("answers", "ends"),
    [([True], "closed"), ([None, True], "closed"), ([False], "let go"), ([None, None, None], "denied")],
)
def test_in_a_whole_run_a_negotiation_comes_to_its_end(answers: list[bool | None], ends: str) -> None:
    """True takes the offer, None asks for the same again, False lets go."""
    commands: list[tuple[int, Command]] = [(1_000_000, msgspec.structs.replace(ASK, override="hard-preempt"))]
    for number, answer in enumerate(answers, 1):
        commands.append(
            (
                1_000_000 + number * 2_000_000,
                AnswerOffer(A, "q1", answer is True, "hard-preempt" if answer is None else None),
            )
        )
    run = played(commands, offered("soft-priority"))
    assert len(of(run, RequestCountered)) == len(of(run, OfferAnswered)) == len(answers)
    assert bool(of(run, RequestClosed)) == (ends == "closed")
    assert [event.reason for _, event in of(run, RequestDenied)] == (["negotiation"] if ends == "denied" else [])
    assert run.state.request.open["q1"].is_over
    assert run.state == fold(run.events)


@pytest.mark.parametrize(
    ("command", "found"),
    [
        (AnswerOffer(A, "q9", True), "unknown request q9"),
        (AnswerOffer(D, "q1", True), "the offer is to robot/A1"),
        (AnswerOffer(A, "q1", True, "hard-preempt"), "soft-priority was offered"),
        (AnswerOffer("robot/A1", "q1", False, "absolute"), "unknown override level"),  # type: ignore[arg-type]
    ],
)
def test_an_answer_to_no_open_offer_is_rejected(command: AnswerOffer, found: str) -> None:
    rejected = only(CommandRejected, decided(countered(), command))
    assert found in rejected.reason
    again = only(CommandRejected, decided(served(countered(), AnswerOffer(A, "q1", True)), AnswerOffer(A, "q1", True)))
    assert again.reason == "no counter-offer is open, expected one to answer"


def executing(result_of: str = "q1") -> State:
    """Return the state in which the request is being executed."""
    state = served(asked(), EvaluateRequest(result_of), TakeTurn(result_of))
    apply(state, past.started(Subject("visit", "q1"), B, A, DOOR, 9_000_000))
    return state


@pytest.mark.parametrize(("result", "achieved"), [("success", ()), ("partial", ("door.opened",)), ("failure", ())])
def test_a_reported_result_ends_the_execution_and_the_closing_carries_it_on(
    result: Any, achieved: tuple[str, ...]
) -> None:
    finished = only(ExecutionFinished, decided(executing(), ReportResult(B, "q1", result, achieved)))
    assert (finished.result, finished.achieved, finished.principals.executed_by) == (result, achieved, "robot/B1")
    started = of(played([(1_000_000, ASK)]), ExecutionStarted)[0][0]
    run = played([(1_000_000, ASK), (started + 1_000, ReportResult(B, "q1", result, achieved))])
    [(_, closed)] = of(run, RequestClosed)
    assert closed.result == result
    assert of(run, AuthorityReleased)
    assert run.state.authority.claims == {}
    assert run.state.request.open["q1"].is_over


@pytest.mark.parametrize(
    ("command", "found"),
    [
        (ReportResult(B, "q9", "success"), "unknown request"),
        (ReportResult(A, "q1", "success"), "robot/B1 executes it"),
        (ReportResult(B, "q1", "partial"), "a partial result with 0 postconditions"),
        (ReportResult(B, "q1", "success", ("door.open",)), "a success result with 1 postconditions"),
    ],
)
def test_a_result_of_nothing_that_the_executor_executes_is_rejected(command: ReportResult, found: str) -> None:
    rejected = only(CommandRejected, decided(executing(), command))
    assert found in rejected.reason


def test_a_result_before_the_start_or_after_the_end_is_rejected() -> None:
    report = ReportResult(B, "q1", "success")
    for state, found in (
        (asked(), "has not been admitted"),
        (served(asked(), EvaluateRequest("q1")), "it is queued"),
        (served(executing(), report), "the request is over"),
    ):
        rejected = only(CommandRejected, decided(state, report))
        assert found in rejected.reason


def test_a_result_achieves_nothing_that_the_contract_does_not_promise() -> None:
    state = executing()
    module = msgspec.structs.replace(
        state.registry.modules[B][DOOR],
        contract=msgspec.structs.replace(
            state.registry.modules[B][DOOR].contract, postconditions=("door.open", "door.unlocked")
        ),
    )
    state.registry = msgspec.structs.replace(
        state.registry, modules={**state.registry.modules, "robot/B1": {**state.registry.modules[B], DOOR: module}}
    )
    assert types(decided(state, ReportResult(B, "q1", "partial", ("door.unlocked",)))) == ["ExecutionFinished"]
    assert types(decided(state, ReportResult(B, "q1", "partial", ("window.open",)))) == ["CommandRejected"]


def test_a_step_whose_result_is_no_success_is_asked_for_again() -> None:
    begun = (ARRIVED,)
    started = next(time for time, event in of(played([], *begun), ExecutionStarted) if event.robot == "robot/B1")
    run = played([(started + 1_000, ReportResult(B, "A1-1/2.1", "failure"))], *begun)
    attempts = [event.attempt for _, event in of(run, StepBegan) if event.step == 2]
    assert attempts == [1, 2]
    found = [event.subject.action_id for _, event in of(run, StepCompleted)]
    assert found == ["A1-1/1.1", "A1-1/2.2"]
    assert len(of(run, TaskCompleted)) == 1


def test_a_request_by_itself_in_the_context_of_a_task_leaves_the_task_alone() -> None:
    ask = msgspec.structs.replace(ASK, context="A1-1", action_id="q1")
    denied = msgspec.structs.replace(ASK, context="A1-1", action_id="q2", directives=("plan",))
    run = played([(1_000, ask), (1_001, denied)], ARRIVED)
    found = [event.subject.action_id for _, event in of(run, StepCompleted)]
    assert found == ["A1-1/1.1", "A1-1/2.1"]
    told = {event.subject.action_id for _, event in of(run, RequestClosed)}
    assert told == {"q1", "A1-1/2.1"}
    assert [event.subject.action_id for _, event in of(run, RegistryQueried)] == ["A1-1/2.1"]
    assert run.state == fold(run.events)
