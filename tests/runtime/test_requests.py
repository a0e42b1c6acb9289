"""Requests: admissible conjunct by conjunct, answered, ordered by override level."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import OverrideLevel, Robot, Subject
from fsar_ledger.events.registry import CapabilityAdvertised, CapabilityRemoved, CapabilityWithdrawn
from fsar_ledger.events.request import RequestAdmitted, RequestDenied, RequestIssued
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.registry import Registry
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest, RelayRequest
from fsar_ledger.runtime.handlers.admissibility import evaluate
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.request import RequestCapability
from tests import past
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, DOOR, OWN_STEP, A, B, C, D, given, happen, types, window
from tests.runtime.live import decided, play
from tests.sure import only

ASK = RequestCapability(A, B, DOOR, "visit", "q1")
RUNNING = ("RequestAdmitted", "ExecutionQueued")


def offered(level: OverrideLevel, **changes: Any) -> CapabilityAdvertised:
    """B1 lets requests for its door carry this override level."""
    return msgspec.structs.replace(past.advertised(B, DOOR), override_allowed=level, **changes)


def asked(
    *before: Event, command: RequestCapability = ASK, configuration: Any = "full", after: tuple[Event, ...] = ()
) -> State:
    """The state in which the request has just been issued, and then this has happened."""
    state = given("fsar", *before, configuration=configuration)
    happen(state, *decided(state, command), *after)
    return state


def verdict(state: State, action_id: str = "q1") -> tuple[str, str | None]:
    request = state.request.open[action_id]
    found = evaluate(state, request, request.candidates[0])
    return found.verdict, found.conjunct


def served(state: State, *commands: Command) -> State:
    """The state after these commands."""
    for command in commands:
        play(state, command)
    return state


def test_a_request_says_who_asks_whom_for_what_in_which_context() -> None:
    gap, issued = decided(given("fsar"), ASK)
    assert type(gap).__name__ == "GapDetected"
    assert isinstance(issued, RequestIssued)
    assert (issued.principals.requested_by, issued.principals.executed_by) == ("robot/A1", "robot/B1")
    assert (issued.capability, issued.subject.task_id) == (DOOR, "visit")
    assert issued.principals.supervised_by == "supervisor/A1"


def test_an_admissible_request_is_accepted_with_its_trust_and_its_authority() -> None:
    admitted, _ = decided(asked(), EvaluateRequest("q1"))
    assert isinstance(admitted, RequestAdmitted)
    assert (admitted.trust, admitted.may_request, admitted.may_execute) == ("task", True, True)
    assert (admitted.override, admitted.is_audited) == ("none", True)


BUSY = (ARRIVED, OWN_STEP)
EXPIRED = TaskCompleted("visit")
DISTRUST = past.trusted(B, A, "none")


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
        ((past.available(B, None, "offline", "battery"),), {}, "local-execution"),
        ((EXPIRED,), {}, "authority"),
        ((past.revoked(A, B),), {}, "authority"),
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
    denied = only(RequestDenied, decided(state, EvaluateRequest("q1")))
    assert (denied.reason, denied.principals.path) == (conjunct, state.request.open["q1"].candidates)
    apply(state, denied)
    assert decided(state, EvaluateRequest("q1")) == (), "a denied request is over"


def test_a_requester_outside_the_executors_domain_sees_no_advertisement_of_it() -> None:
    inside = "hall"
    state = asked(after=(offered("none", visibility="domain"),))
    assert verdict(state)[0] == "accept", "a flat fleet is one domain"

    def moved(robot: Robot, domain: str) -> Registry:
        members = state.registry.members
        return msgspec.structs.replace(state.registry, members={**members, robot: (members[robot][0], domain)})

    state.registry = moved(B, inside)
    apply(state, offered("none", visibility="domain"))
    assert verdict(state) == ("reject", "advertisement")
    for domain, expected in (("hall", "accept"), ("hall/cell", "accept"), ("hallway", "reject")):
        state.registry = moved(A, domain)
        assert verdict(state)[0] == expected


def test_without_trust_evaluation_trust_is_no_conjunct_and_no_part_of_the_admission() -> None:
    state = asked(after=(DISTRUST,), configuration="without-trust-evaluation")
    admitted, _ = decided(state, EvaluateRequest("q1"))
    assert isinstance(admitted, RequestAdmitted)
    assert admitted.trust is None


def test_policy_that_wants_a_review_is_put_before_a_supervisor_only_if_all_else_holds() -> None:
    reviewed = asked(after=(window(B, "review"),))
    assert types(decided(reviewed, EvaluateRequest("q1"))) == ["SupervisorCalled"]
    assert verdict(asked(after=(window(B, "review"), EXPIRED))) == ("reject", "authority")


def test_what_was_approved_is_still_denied_when_trust_is_gone_by_then() -> None:
    state = asked(after=(window(B, "review"),))
    play(state, EvaluateRequest("q1"))
    apply(state, past.approved(Subject("visit", "q1"), A, B))
    request = state.request.open["q1"]
    assert evaluate(state, request, B, is_reviewed=True).verdict == "accept"
    apply(state, DISTRUST)
    assert evaluate(state, request, B, is_reviewed=True).conjunct == "trust"


def test_a_busy_executor_defers_and_the_request_is_served_in_its_turn() -> None:
    state = served(asked(), EvaluateRequest("q1"))
    second = msgspec.structs.replace(ASK, action_id="q2")
    play(state, second)
    assert types(decided(state, EvaluateRequest("q2"))) == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


RELAYED = past.queried(Subject("A1-1", "A1-1/2.1"), past.parties(D, B), DOOR, B, relay=A)
D_STEP = past.began(Subject("A1-1", "A1-1/2.1"), D, 2, DOOR, "B")


def relayed(*after: Event) -> State:
    """D1's request to B1 has been issued and stands before its relay A1."""
    issued = past.issued("A1-1/2.1", past.principals(D, D, B), DOOR, "A1-1", relay=A)
    return given("fsar", ARRIVED, D_STEP, RELAYED, issued, *after)


def test_each_link_of_a_relayed_request_rests_on_its_own_trust() -> None:
    state = relayed()
    assert types(decided(state, RelayRequest("A1-1/2.1"))) == ["RequestRelayed"]
    admitted, _ = decided(state, EvaluateRequest("A1-1/2.1"))
    assert isinstance(admitted, RequestAdmitted)
    assert admitted.trust == "task", "of B1 in A1; B1 does not trust D1"
    denied = only(RequestDenied, decided(relayed(past.trusted(A, D, "none")), RelayRequest("A1-1/2.1")))
    assert (denied.reason, denied.principals.decided_by) == ("trust", "robot/A1")
    assert verdict(relayed(DISTRUST), "A1-1/2.1") == ("reject", "trust")


def test_rights_along_a_chain_never_add_up_to_a_right_of_its_first_at_its_last() -> None:
    """A1 may ask B1 and B1 may ask C1; A1 at C1 has no trust whatever was granted along the way, and C1 judges B1
    alone."""
    grants = (past.granted(A, B), past.granted(B, C))
    state = served(asked(*grants), EvaluateRequest("q1"))
    onward = RequestCapability(B, C, "inspect.visual", "visit", "q2", parent="q1")
    play(state, onward)
    assert state.request.open["q2"].parent == "q1"
    assert verdict(state, "q2") == ("accept", None)
    direct = RequestCapability(A, C, "inspect.visual", "visit", "q3")
    play(state, direct)
    assert verdict(state, "q3") == ("reject", "trust")
    apply(state, past.trusted(C, B, "none"))
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
    finished = past.denied("old", past.principals(B, A, B), "policy", "visit")
    first = msgspec.structs.replace(ASK, action_id="old")
    state = asked(ARRIVED, DELEGATED_STEP, TaskCompleted("A1-9"), command=first, after=(finished,))
    before = {slot: getattr(state, slot) for slot in State.__slots__}
    rejected = only(CommandRejected, decided(state, RequestCapability(**{**msgspec.structs.asdict(ASK), **changes})))
    assert (rejected.command, found in rejected.reason) == ("RequestCapability", True), rejected.reason
    apply(state, rejected)
    assert before == {slot: getattr(state, slot) for slot in State.__slots__}
