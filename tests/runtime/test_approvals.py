"""What an approval covers: the windows and rules that stood when it was given. Paper: sec:model:policy."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Subject
from fsar_ledger.events.execution import ExecutionHeld
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.supervision import SupervisionDensitySet
from fsar_ledger.events.world import PolicyWindowClosed, PolicyWindowOpened
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import StartAction, TakeTurn
from fsar_ledger.runtime.handlers.request import ReportResult
from tests import past
from tests.runtime.histories import DOOR, A, B, given, happen, types
from tests.runtime.live import decided, play
from tests.runtime.test_authority import ASK, H_B, scheduled
from tests.sure import only

APPROVAL = past.approved(Subject("visit", "q1"), A, B)


def approved(*before: Event) -> State:
    """A1's request is admitted at B1 after H_F approved its review; B1 is about to start."""
    state = given("fsar", *before)
    assert types(play(state, ASK, EvaluateRequest("q1"))) == ["SupervisorCalled"]
    play(state, *scheduled(state, APPROVAL), TakeTurn("q1"))
    return state


def opened(name: str, outcome: Any) -> PolicyWindowOpened:
    return PolicyWindowOpened(robot=B, scope="local", window=name, outcome=outcome)


START = StartAction("q1", answer=5)


def test_an_approval_lifts_no_rule_that_denies_by_then() -> None:
    """Whether the review was wanted by policy or by density alone, the executor does not act against a rule; a mandate
    against it is escalated."""
    mandate = past.ruled_for_all("allow", None, DOOR)
    own = PolicyRuleSet(scope="local", robot=B, capability=DOOR, context=None, outcome="deny", decided_by=H_B)
    fleets = past.ruled_for_all("deny", None, DOOR)
    heard = FleetRuleLearned(B, "deny", 1)
    dense = SupervisionDensitySet(robot=B, review_every=1, decided_by=H_B, reason="")
    cases: list[tuple[Event, tuple[Event, ...], list[str]]] = [
        (opened("w1", "review"), (own,), ["RequestDenied"]),
        (opened("w1", "review"), (fleets,), ["RequestDenied"]),
        (opened("w1", "review"), (heard,), ["RequestDenied"]),
        (dense, (own,), ["RequestDenied"]),
        (dense, (mandate, own), ["PolicyConflictEscalated", "RequestDenied"]),
    ]
    for before, meanwhile, expected in cases:
        state = given("fsar", before)
        assert types(play(state, ASK, EvaluateRequest("q1"))) == ["SupervisorCalled"]
        happen(state, *meanwhile)
        answer = play(state, *scheduled(state, APPROVAL))
        assert types(answer) == expected
        assert answer[-1].reason == "policy"


def test_an_approval_stands_while_a_window_denies_and_the_start_waits_for_it_to_close() -> None:
    state = given("fsar", opened("w1", "review"))
    play(state, ASK, EvaluateRequest("q1"))
    apply(state, opened("w2", "deny"))
    assert types(play(state, *scheduled(state, APPROVAL))) == ["RequestAdmitted", "ExecutionQueued"]
    assert types(play(state, TakeTurn("q1"), START)) == ["ExecutionHeld"]
    only(StartAction, scheduled(state, PolicyWindowClosed(B, "local", "w2")))
    assert types(play(state, START)) == ["ExecutionStarted"]


def test_what_a_rule_held_after_its_approval_starts_when_that_rule_is_lifted_although_the_approved_one_stands() -> None:
    rule = PolicyRuleSet(scope="local", robot=B, capability=DOOR, context=None, outcome="review", decided_by=H_B)
    state = approved(rule)
    broad = PolicyRuleSet(scope="local", robot=B, capability=None, context=None, outcome="deny", decided_by=H_B)
    apply(state, broad)
    assert types(play(state, START)) == ["ExecutionHeld"]
    only(StartAction, scheduled(state, msgspec.structs.replace(broad, outcome="review")))
    assert types(decided(state, START)) == ["ExecutionHeld", "SupervisorCalled"], "nobody has reviewed that rule"
    only(StartAction, scheduled(state, msgspec.structs.replace(broad, outcome="allow")))
    assert types(play(state, START)) == ["ExecutionStarted"]


def test_an_approval_covers_the_windows_that_were_open_when_it_was_given() -> None:
    assert types(play(approved(opened("w1", "review")), START)) == ["ExecutionStarted"]


@pytest.mark.parametrize("outcome", ["deny", "review"])
def test_a_window_of_the_executors_own_that_opens_after_the_approval_holds_the_start(outcome: Any) -> None:
    state = approved(opened("w1", "review"))
    apply(state, opened("w2", outcome))
    held = only(ExecutionHeld, play(state, START))
    assert (held.outcome, held.reason) == (outcome, "local-policy")
    [again] = scheduled(state, PolicyWindowClosed(B, "local", "w2"))
    assert isinstance(again, StartAction), "although the first is open still"
    assert types(play(state, START)) == ["ExecutionStarted"]


def test_a_rule_that_is_set_after_the_approval_holds_the_start_and_one_set_before_does_not() -> None:
    rule = PolicyRuleSet(scope="local", robot=B, capability=DOOR, context=None, outcome="review", decided_by=H_B)
    assert types(play(approved(rule), START)) == ["ExecutionStarted"]
    state = approved(rule)
    apply(state, msgspec.structs.replace(rule, outcome="deny"))
    assert types(play(state, START)) == ["ExecutionHeld"]
    other = approved(rule)
    apply(other, msgspec.structs.replace(rule, capability="door.open.basic", outcome="deny"))
    assert types(play(other, START)) == ["ExecutionStarted"], "about something else"


def test_a_rule_of_the_role_set_after_the_approval_is_reviewed_at_the_start_unless_the_robot_is_an_exception() -> None:
    own = PolicyRuleSet(scope="local", robot=B, capability=DOOR, context=None, outcome="review", decided_by=H_B)
    of_role = RolePolicyRuleSet(scope="local", role="B", outcome="review", domain="", capability=DOOR)
    assert types(play(approved(of_role), START)) == ["ExecutionStarted"], "known when it was given"
    starts, asks = ["ExecutionStarted"], ["ExecutionHeld", "SupervisorCalled"]
    cases: list[tuple[Event, Event, list[str]]] = [
        (opened("w1", "review"), of_role, asks),
        (of_role, own, asks),
        (own, of_role, starts),
        (own, msgspec.structs.replace(of_role, outcome="deny"), starts),
        (own, msgspec.structs.replace(of_role, capability=None), asks),
        (opened("w1", "review"), msgspec.structs.replace(of_role, role="A"), starts),
        (opened("w1", "review"), msgspec.structs.replace(of_role, domain="yard"), starts),
    ]
    for before, after, expected in cases:
        state = approved(before)
        apply(state, after)
        assert types(play(state, START)) == expected, (before, after)


def test_what_was_approved_is_forgotten_when_it_is_done() -> None:
    state = approved(opened("w1", "review"))
    assert list(state.authority.approvals) == ["q1"]
    play(state, START, ReportResult(B, "q1", "success"))
    assert state.authority.approvals == {}


def test_a_start_without_a_review_waits_for_policy_as_ever() -> None:
    state = given("fsar")
    play(state, ASK, EvaluateRequest("q1"), TakeTurn("q1"))
    apply(state, opened("w1", "deny"))
    assert types(play(state, START)) == ["ExecutionHeld"]
    apply(state, FleetRuleLearned(B, "allow", 1))
    assert types(play(state, START)) == ["ExecutionHeld"]
