"""Requests: admissible conjunct by conjunct, negotiated, answered with a result, ordered by override level."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityGranted, AuthorityReleased, AuthorityRevoked
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import (
    FLEET_SUPERVISOR,
    OverrideLevel,
    Parties,
    Principals,
    RequestSubject,
    Robot,
    Subject,
)
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.registry import (
    AvailabilityChanged,
    CapabilityAdvertised,
    CapabilityRemoved,
    CapabilityWithdrawn,
    RegistryQueried,
)
from fsar_ledger.events.request import (
    OfferAnswered,
    RequestAdmitted,
    RequestClosed,
    RequestCountered,
    RequestDenied,
    RequestIssued,
)
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskCompleted
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.architectures.fsar.request import (
    EvaluateRequest,
    RelayRequest,
    evaluate_request,
    relay_request,
)
from fsar_ledger.runtime.handlers.admissibility import evaluate
from fsar_ledger.runtime.handlers.commands import Command, TakeTurn
from fsar_ledger.runtime.handlers.request import AnswerOffer, ReportResult, RequestCapability
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, OWN_STEP, given, types, window
from tests.runtime.live import decided, of, played

A, B, C, D = Robot("robot/A1"), Robot("robot/B1"), Robot("robot/C1"), Robot("robot/D1")

DOOR = "door.open.secure"
ASK = RequestCapability(A, B, DOOR, "visit", "q1")
RUNNING = ("RequestAdmitted", "ExecutionQueued")


def offered(level: OverrideLevel, **changes: Any) -> CapabilityAdvertised:
    """B1 lets requests for its door carry this override level."""
    return msgspec.structs.replace(CapabilityAdvertised(robot=B, capability=DOOR), override_allowed=level, **changes)


def asked(
    *before: Event, command: RequestCapability = ASK, configuration: Any = "full", after: tuple[Event, ...] = ()
) -> State:
    """The state in which the request has just been issued, and then this has happened."""
    state = given("fsar", *before, configuration=configuration)
    for event in (*decided(state, command), *after):
        apply(state, event)
    return state


def verdict(state: State, action_id: str = "q1") -> tuple[str, str | None]:
    request = state.request[action_id]
    found = evaluate(state, request, request.candidates[0])
    return found.verdict, found.conjunct


def served(state: State, *commands: Command) -> State:
    """The state after these commands."""
    for command in commands:
        for event in decided(state, command):
            apply(state, event)
    return state


def test_a_request_says_who_asks_whom_for_what_in_which_context() -> None:
    gap, issued = decided(given("fsar"), ASK)
    assert type(gap).__name__ == "GapDetected"
    assert isinstance(issued, RequestIssued)
    assert (
        issued.principals.requested_by,
        issued.principals.executed_by,
        issued.capability,
        issued.subject.task_id,
        issued.principals.supervised_by,
    ) == (
        "robot/A1",
        "robot/B1",
        DOOR,
        "visit",
        "supervisor/A1",
    )


def test_an_admissible_request_is_accepted_with_its_trust_and_its_authority() -> None:
    admitted, _ = evaluate_request(asked(), EvaluateRequest("q1"))
    assert isinstance(admitted, RequestAdmitted)
    assert (admitted.trust, admitted.may_request, admitted.may_execute, admitted.override, admitted.is_audited) == (
        "task",
        True,
        True,
        "none",
        True,
    )


BUSY = (ARRIVED, OWN_STEP)
EXPIRED = TaskCompleted("visit")
DISTRUST = TrustSet(robot=B, peer=A, scope="none")


@pytest.mark.parametrize(
    ("after", "changes", "conjunct"),
    [
        ((CapabilityRemoved(B, DOOR),), {}, "possession"),
        ((), {"executor": "robot/C1"}, "possession"),
        ((CapabilityWithdrawn(B, DOOR, "maintenance"),), {}, "advertisement"),
        ((offered("none", visible_to=("D",)),), {}, "advertisement"),
        ((offered("none", version="2.0.0"),), {"version": "1.0.0"}, "advertisement"),
        ((DISTRUST,), {}, "trust"),
        ((offered("none", trust_required="session"),), {}, "trust"),
        ((DISTRUST, offered("none", visibility="trust-gated")), {}, "advertisement"),
        ((window(B),), {}, "policy"),
        ((offered("none", policy_required=("rounds",)),), {}, "policy"),
        ((), {"directives": ("plan",)}, "local-execution"),
        (
            (AvailabilityChanged(robot=B, capability=None, availability="offline", reason="battery"),),
            {},
            "local-execution",
        ),
        ((EXPIRED,), {}, "authority"),
        (
            (
                AuthorityRevoked(
                    requested_by=A,
                    executed_by=B,
                    capability=None,
                    context=None,
                    reason="human override",
                    decided_by=FLEET_SUPERVISOR,
                ),
            ),
            {},
            "authority",
        ),
        ((DISTRUST, window(B), EXPIRED), {"directives": ("policy",)}, "trust"),
        ((window(B), EXPIRED), {"directives": ("recovery",)}, "policy"),
        ((EXPIRED,), {"directives": ("plan",)}, "local-execution"),
    ],
)
def test_the_first_conjunct_that_fails_is_the_reason(
    after: tuple[Event, ...], changes: dict[str, Any], conjunct: str
) -> None:
    state = asked(command=RequestCapability(**{**msgspec.structs.asdict(ASK), **changes}), after=after)
    assert verdict(state) == ("reject", conjunct)
    [denied] = evaluate_request(state, EvaluateRequest("q1"))
    assert isinstance(denied, RequestDenied)
    assert denied.reason == conjunct
    apply(state, denied)
    assert evaluate_request(state, EvaluateRequest("q1")) == (), "a denied request is over"


def test_a_requester_outside_the_executors_domain_sees_no_advertisement_of_it() -> None:
    inside = "hall"
    state = asked(after=(offered("none", visibility="domain"),))
    assert verdict(state)[0] == "accept", "a flat fleet is one domain"
    state.registry = msgspec.structs.replace(state.registry, domains={**state.registry.domains, "robot/B1": inside})
    apply(state, offered("none", visibility="domain"))
    assert verdict(state) == ("reject", "advertisement")
    for domain, expected in (("hall", "accept"), ("hall/cell", "accept"), ("hallway", "reject")):
        state.registry = msgspec.structs.replace(state.registry, domains={**state.registry.domains, "robot/A1": domain})
        assert verdict(state)[0] == expected


def test_without_trust_evaluation_trust_is_no_conjunct_and_no_part_of_the_admission() -> None:
    state = asked(after=(DISTRUST,), configuration="without-trust-evaluation")
    admitted, _ = evaluate_request(state, EvaluateRequest("q1"))
    assert isinstance(admitted, RequestAdmitted)
    assert admitted.trust is None


def test_policy_that_wants_a_review_is_put_before_a_supervisor_only_if_all_else_holds() -> None:
    reviewed = asked(after=(window(B, "review"),))
    assert types(evaluate_request(reviewed, EvaluateRequest("q1"))) == ["SupervisorCalled"]
    assert verdict(asked(after=(window(B, "review"), EXPIRED))) == ("reject", "authority")


def test_what_was_approved_is_still_denied_when_trust_is_gone_by_then() -> None:
    state = asked(after=(window(B, "review"),))
    for event in evaluate_request(state, EvaluateRequest("q1")):
        apply(state, event)
    apply(
        state,
        SupervisorResponded(
            Subject("visit", "q1"),
            Principals(
                decided_by=FLEET_SUPERVISOR,
                requested_by=A,
                executed_by=B,
                supervised_by=FLEET_SUPERVISOR,
                path=(FLEET_SUPERVISOR,),
            ),
            "review",
        ),
    )
    request = state.request["q1"]
    assert evaluate(state, request, B, is_reviewed=True).verdict == "accept"
    apply(state, DISTRUST)
    assert evaluate(state, request, B, is_reviewed=True).conjunct == "trust"


def test_a_busy_executor_defers_and_the_request_is_served_in_its_turn() -> None:
    state = served(asked(), EvaluateRequest("q1"))
    second = msgspec.structs.replace(ASK, action_id="q2")
    for event in decided(state, second):
        apply(state, event)
    assert types(evaluate_request(state, EvaluateRequest("q2"))) == [
        "RequestAdmitted",
        "RequestDeferred",
        "ExecutionQueued",
    ]


RELAYED = RegistryQueried(
    subject=Subject("A1-1", "A1-1/2.1"),
    principals=Parties(requested_by=D, executed_by=B, supervised_by=None),
    capability=DOOR,
    candidates=(B,),
    relay=A,
)
D_STEP = StepBegan(subject=Subject("A1-1", "A1-1/2.1"), robot=D, step=2, attempt=1, capability=DOOR, target_role="B")


def relayed(*after: Event) -> State:
    """D1's request to B1 has been issued and stands before its relay A1."""
    issued = RequestIssued(
        subject=RequestSubject("A1-1", "A1-1/2.1", "A1-1/2.1"),
        principals=Principals(
            decided_by=D,
            requested_by=D,
            executed_by=B,
            supervised_by=None,
            path=(D,),
        ),
        capability=DOOR,
        carried_policy="allow",
        relay=A,
    )
    return given("fsar", ARRIVED, D_STEP, RELAYED, issued, *after)


def test_each_link_of_a_relayed_request_rests_on_its_own_trust() -> None:
    state = relayed()
    assert types(relay_request(state, RelayRequest("A1-1/2.1"))) == ["RequestRelayed"]
    admitted, _ = evaluate_request(state, EvaluateRequest("A1-1/2.1"))
    assert isinstance(admitted, RequestAdmitted)
    assert admitted.trust == "task", "of B1 in A1; B1 does not trust D1"
    [denied] = relay_request(relayed(TrustSet(robot=A, peer=D, scope="none")), RelayRequest("A1-1/2.1"))
    assert isinstance(denied, RequestDenied)
    assert (denied.reason, denied.principals.decided_by) == ("trust", "robot/A1")
    assert verdict(relayed(DISTRUST), "A1-1/2.1") == ("reject", "trust")


def test_rights_along_a_chain_never_add_up_to_a_right_of_its_first_at_its_last() -> None:
    """A1 may ask B1 and B1 may ask C1; A1 at C1 has no trust whatever was granted along the way, and C1 judges B1 alone."""
    grants = (
        AuthorityGranted(
            requested_by=A,
            executed_by=B,
            capability=None,
            context=None,
            override="none",
            decided_by=FLEET_SUPERVISOR,
        ),
        AuthorityGranted(
            requested_by=B,
            executed_by=C,
            capability=None,
            context=None,
            override="none",
            decided_by=FLEET_SUPERVISOR,
        ),
    )
    state = served(asked(*grants), EvaluateRequest("q1"))
    onward = RequestCapability(B, C, "inspect.visual", "visit", "q2", parent="q1")
    for event in decided(state, onward):
        apply(state, event)
    assert state.request["q2"].parent == "q1"
    assert verdict(state, "q2") == ("accept", None)
    direct = RequestCapability(A, C, "inspect.visual", "visit", "q3")
    for event in decided(state, direct):
        apply(state, event)
    assert verdict(state, "q3") == ("reject", "trust")
    apply(state, TrustSet(robot=C, peer=B, scope="none"))
    assert verdict(state, "q2") == ("reject", "trust"), "the parent's admission does not carry its link"


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"requester": "robot/Z9"}, "unknown robot robot/Z9"),
        ({"executor": "robot/Z9"}, "unknown robot robot/Z9"),
        ({"capability": "fly"}, "unknown capability fly"),
        ({"executor": "robot/A1"}, "asks itself"),
        ({"context": "A1-9"}, "is over"),
        ({"context": ""}, "no name"),
        ({"action_id": "old"}, "is taken"),
        ({"action_id": "A1-1/7.1"}, "is taken"),
        ({"action_id": "A1-9/1.1"}, "is taken"),
        ({"parent": "nothing"}, "unknown parent nothing"),
        ({"parent": "old"}, "is over"),
        ({"parent": "A1-1/2.1"}, "does not execute A1-1/2.1"),
        ({"override": "absolute"}, "unknown override level absolute"),
    ],
)
def test_a_request_that_names_something_unknown_over_or_impossible_is_rejected_and_changes_nothing(
    changes: dict[str, Any], found: str
) -> None:
    finished = RequestDenied(
        RequestSubject("visit", "old", "old"),
        Principals(
            decided_by=B,
            requested_by=A,
            executed_by=B,
            supervised_by=None,
            path=(B,),
        ),
        "policy",
    )
    first = msgspec.structs.replace(ASK, action_id="old")
    state = asked(ARRIVED, DELEGATED_STEP, TaskCompleted("A1-9"), command=first, after=(finished,))
    before = {slot: getattr(state, slot) for slot in State.__slots__}
    [rejected] = decided(state, RequestCapability(**{**msgspec.structs.asdict(ASK), **changes}))
    assert isinstance(rejected, CommandRejected)
    assert (rejected.command, found in rejected.reason) == ("RequestCapability", True), rejected.reason
    apply(state, rejected)
    assert before == {slot: getattr(state, slot) for slot in State.__slots__}


def countered(level: OverrideLevel = "hard-preempt", allowed: OverrideLevel = "soft-priority", *before: Event) -> State:
    command = msgspec.structs.replace(ASK, override=level)
    return served(asked(offered(allowed), *before, command=command), EvaluateRequest("q1"))


def test_an_executor_asked_for_more_override_than_it_allows_offers_what_it_allows() -> None:
    state = asked(offered("soft-priority"), command=msgspec.structs.replace(ASK, override="hard-preempt"))
    [counter] = evaluate_request(state, EvaluateRequest("q1"))
    assert isinstance(counter, RequestCountered)
    assert (counter.round, counter.override, counter.principals.decided_by) == (1, "soft-priority", "robot/B1")
    apply(state, counter)
    assert evaluate_request(state, EvaluateRequest("q1")) == (), "it waits for the answer"


def test_a_grant_of_less_than_the_executor_allows_is_the_limit() -> None:
    grant = AuthorityGranted(
        requested_by=A,
        executed_by=B,
        capability=DOOR,
        context=None,
        override="soft-priority",
        decided_by=FLEET_SUPERVISOR,
    )
    assert countered("hard-preempt", "hard-preempt", grant).request["q1"].offered == "soft-priority"


def test_a_taken_offer_admits_the_request_on_those_terms() -> None:
    state = countered()
    [answer] = decided(state, AnswerOffer(A, "q1", True))
    assert isinstance(answer, OfferAnswered)
    assert (answer.round, answer.is_accepted, answer.override) == (1, True, "soft-priority")
    apply(state, answer)
    admitted, queued = evaluate_request(state, EvaluateRequest("q1"))
    assert isinstance(admitted, RequestAdmitted)
    assert isinstance(queued, ExecutionQueued)
    assert (admitted.override, queued.override) == ("soft-priority", "soft-priority")


def test_a_negotiation_ends_after_so_many_rounds() -> None:
    state = countered()
    rounds = state.fleet.structure.negotiation_rounds
    for number in range(1, rounds + 1):
        assert (state.request["q1"].offers, state.request["q1"].offered) == (number, "soft-priority")
        state = served(state, AnswerOffer(A, "q1", False, "hard-preempt"))
        events = evaluate_request(state, EvaluateRequest("q1"))
        for event in events:
            apply(state, event)
    [denied] = events
    assert isinstance(denied, RequestDenied)
    assert denied.reason == "negotiation"


def test_a_requester_that_lets_go_ends_its_request() -> None:
    state = served(countered(), AnswerOffer(A, "q1", False))
    assert state.request["q1"].is_over
    assert evaluate_request(state, EvaluateRequest("q1")) == ()


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
    assert [event.reason for _, event in of(run, RequestDenied)] == (["negotiation"] if ends == "denied" else [])  # type: ignore[attr-defined]
    assert run.state.request["q1"].is_over
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
    [rejected] = decided(countered(), command)
    assert isinstance(rejected, CommandRejected)
    assert found in rejected.reason
    [again] = decided(served(countered(), AnswerOffer(A, "q1", True)), AnswerOffer(A, "q1", True))
    assert isinstance(again, CommandRejected)
    assert again.reason == "no counter-offer is open, expected one to answer"


def executing(result_of: str = "q1") -> State:
    """The request is being executed."""
    state = served(asked(), EvaluateRequest(result_of), TakeTurn(result_of))
    apply(
        state,
        ExecutionStarted(
            subject=Subject("visit", "q1"),
            principals=Parties(requested_by=A, executed_by=B, supervised_by=None),
            robot=B,
            on_behalf_of=A,
            capability=DOOR,
            ends_us=9_000_000,
        ),
    )
    return state


@pytest.mark.parametrize(("result", "achieved"), [("success", ()), ("partial", ("door.opened",)), ("failure", ())])
def test_a_reported_result_ends_the_execution_and_the_closing_carries_it_on(
    result: Any, achieved: tuple[str, ...]
) -> None:
    [finished] = decided(executing(), ReportResult(B, "q1", result, achieved))
    assert isinstance(finished, ExecutionFinished)
    assert (finished.result, finished.achieved, finished.principals.executed_by) == (result, achieved, "robot/B1")
    started = of(played([(1_000_000, ASK)]), ExecutionStarted)[0][0]
    run = played([(1_000_000, ASK), (started + 1_000, ReportResult(B, "q1", result, achieved))])
    [(_, closed)] = of(run, RequestClosed)
    assert isinstance(closed, RequestClosed)
    assert closed.result == result
    assert of(run, AuthorityReleased)
    assert run.state.authority.claims == {}
    assert run.state.request["q1"].is_over


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
    [rejected] = decided(executing(), command)
    assert isinstance(rejected, CommandRejected)
    assert found in rejected.reason


def test_a_result_before_the_start_or_after_the_end_is_rejected() -> None:
    report = ReportResult(B, "q1", "success")
    for state, found in (
        (asked(), "has not been admitted"),
        (served(asked(), EvaluateRequest("q1")), "it is queued"),
        (served(executing(), report), "the request is over"),
    ):
        [rejected] = decided(state, report)
        assert isinstance(rejected, CommandRejected)
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
        state.registry,
        modules={**state.registry.modules, "robot/B1": {**state.registry.modules[B], DOOR: module}},
    )
    assert types(decided(state, ReportResult(B, "q1", "partial", ("door.unlocked",)))) == ["ExecutionFinished"]
    assert types(decided(state, ReportResult(B, "q1", "partial", ("window.open",)))) == ["CommandRejected"]


def test_a_step_whose_result_is_no_success_is_asked_for_again() -> None:
    begun = (ARRIVED,)
    started = next(
        time
        for time, event in of(played([], *begun), ExecutionStarted)
        if isinstance(event, ExecutionStarted) and event.robot == "robot/B1"
    )
    run = played([(started + 1_000, ReportResult(B, "A1-1/2.1", "failure"))], *begun)
    attempts = [event.attempt for _, event in of(run, StepBegan) if isinstance(event, StepBegan) and event.step == 2]
    assert attempts == [1, 2]
    assert [event.subject.action_id for _, event in of(run, StepCompleted) if isinstance(event, StepCompleted)] == [
        "A1-1/1.1",
        "A1-1/2.2",
    ]
    assert len(of(run, TaskCompleted)) == 1


def test_a_request_by_itself_in_the_context_of_a_task_leaves_the_task_alone() -> None:
    ask = msgspec.structs.replace(ASK, context="A1-1", action_id="q1")
    denied = msgspec.structs.replace(ASK, context="A1-1", action_id="q2", directives=("plan",))
    run = played([(1_000, ask), (1_001, denied)], ARRIVED)
    assert [event.subject.action_id for _, event in of(run, StepCompleted) if isinstance(event, StepCompleted)] == [
        "A1-1/1.1",
        "A1-1/2.1",
    ]
    assert {event.subject.action_id for _, event in of(run, RequestClosed) if isinstance(event, RequestClosed)} == {
        "q1",
        "A1-1/2.1",
    }
    assert [event.subject.action_id for _, event in of(run, RegistryQueried) if isinstance(event, RegistryQueried)] == [
        "A1-1/2.1"
    ]
    assert run.state == fold(run.events)
