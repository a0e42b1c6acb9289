"""JADE: own policy asked once, owners on record, permissions where there is the add-on JADE-S."""

from collections.abc import Sequence

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat, local_supervisor
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    GapDetected,
    RequestDenied,
    RequestIssued,
    SegmentTransferred,
)
from fsar_ledger.events.world import OutsiderRequestInjected, SupervisorLeft
from fsar_ledger.runtime.architectures.jade import DecideOwnStep
from fsar_ledger.runtime.architectures.jade.contract_net import EvaluateCall
from fsar_ledger.runtime.handlers.commands import BeginStep, DecideRoutine, StartAction, TakeTurn
from tests import past
from tests.runtime.architectures.jade_runs import (
    ACTION,
    DOOR,
    LISTED,
    STEP,
    TASK,
    A,
    B,
    C,
    D,
    S,
    contracted,
    decided,
    follows,
    given,
    play,
    ran,
)
from tests.runtime.histories import ARRIVED, OWN_STEP, happen, types, window
from tests.runtime.live import of
from tests.runtime.test_fairness import reviewers, starts, ward


def test_own_policy_is_asked_once_and_not_again_at_the_start() -> None:
    own = given(ARRIVED, OWN_STEP)
    play(own, DecideOwnStep(STEP))
    happen(own, window(A))
    assert types(decided(own, StartAction(STEP, now_us=9 * S, answer=S))) == ["ExecutionStarted"]
    promised = contracted()
    happen(promised, window(B))
    play(promised, TakeTurn(ACTION))
    assert types(decided(promised, StartAction(ACTION, now_us=9 * S, answer=S))) == ["ExecutionStarted"]


@pytest.mark.parametrize("outcome", ["deny", "review"])
def test_a_step_of_its_own_that_its_policy_does_not_allow_is_tried_anew(outcome: str) -> None:
    state = given(ARRIVED, OWN_STEP, window(A, outcome))
    [denied] = play(state, DecideOwnStep(STEP))
    assert isinstance(denied, RequestDenied)
    assert follows(state, denied) == [BeginStep("A1-1", STEP)]


def test_a_motion_looks_at_the_robots_own_policy_and_sensing_does_not() -> None:
    state = given(window(A))
    assert types(decided(state, DecideRoutine(A, "motion"))) == ["RoutineWithheld"]
    assert types(decided(state, DecideRoutine(A, "sensing"))) == ["RoutinePerformed"]
    assert types(decided(given(window(A, scope="fleet")), DecideRoutine(A, "motion"))) == ["RoutinePerformed"]


def test_a_declared_rule_of_its_own_binds_a_robot_and_a_review_is_put_before_nobody() -> None:
    for outcome in ("allow", "deny", "review"):
        found = ward("jade", outcome, "local")
        assert bool(starts(found)) == (outcome == "allow")
        assert reviewers(found) == set()
        asked = ward("jade", outcome, "local", "door", DOOR)
        assert bool(starts(asked, DOOR)) == (outcome == "allow")


def test_a_declared_rule_of_the_fleet_is_broken_since_nobody_looks_at_it() -> None:
    assert starts(ward("jade", "deny", "fleet"))


def supervisors(events: Sequence[Event]) -> set[str | None]:
    asked = (BidSubmitted, AwardMade, ExecutionQueued, ExecutionStarted, ExecutionFinished, RequestIssued, GapDetected)
    return {flat(event)["supervised_by"] for event in events if isinstance(event, asked)}


def test_ownership_names_the_robots_own_supervisor_or_nobody() -> None:
    assert supervisors(ran([(S, TASK)]).events) == {"supervisor/A1", "supervisor/B1", "supervisor/B2"}
    assert supervisors(ran([(S, TASK)], owner_is_named=0).events) == {None}


def test_a_handed_over_segment_names_an_owner_only_if_ownership_does() -> None:
    two = past.arrived("A1-1", A, ("A navigate.indoor", "B navigate.indoor"), budget_us=90 * S, due_us=91 * S)
    for owner_is_named, expected in ((1, "supervisor/A1"), (0, None)):
        found = [
            event.principals.supervised_by
            for _, event in of(ran([(S, two)], owner_is_named=owner_is_named), SegmentTransferred)
        ]
        assert found == [expected]


def test_an_owner_who_is_off_shift_is_not_named() -> None:
    assert supervisors(decided(given(*LISTED, SupervisorLeft(local_supervisor(B))), EvaluateCall(ACTION, B, 0))) == {
        None
    }


def test_sender_and_receiver_of_each_message_are_on_record() -> None:
    run = ran([(S, TASK)])
    for _, event in of(run, BidSubmitted, AwardMade, ExecutionStarted, ExecutionFinished):
        assert event.principals.requested_by == A
        assert event.principals.executed_by == event.robot


INJECTED = OutsiderRequestInjected(task_id="injected-1", robot=D, peer=C, capability="inspect.private_zone")


def outsider(*before: Event, **dials: int) -> list[str]:
    run = ran([*((1, one) for one in before), (S, INJECTED)], size=4, **dials)
    return [type(event).__name__ for _, event in of(run, ExecutionStarted, RequestDenied)]


def test_an_outsider_is_served_if_the_asked_agents_own_policy_allows() -> None:
    assert outsider() == ["ExecutionStarted"]
    assert outsider(window(C)) == outsider(window(C, "review")) == ["RequestDenied"]


def test_with_permissions_an_outsider_is_refused_and_who_is_trusted_is_served() -> None:
    assert outsider(permissions=1) == ["RequestDenied"]
    refused, _ = decided(given(INJECTED, permissions=1), EvaluateCall("injected-1", C, 0))
    assert isinstance(refused, RequestDenied)
    assert refused.reason == "permission"
    assert types(decided(given(*LISTED, permissions=1), EvaluateCall(ACTION, B, 0)))[0] == "RequestAdmitted"
