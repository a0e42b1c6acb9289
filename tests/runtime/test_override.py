"""Override levels and a busy robot: who waits, who goes ahead, who is interrupted and goes on afterwards.

Paper: eq:override.
"""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import OverrideLevel, Subject
from fsar_ledger.events.execution import ExecutionPaused, ExecutionPreempted, ExecutionQueued, ExecutionResumed
from fsar_ledger.events.request import RequestAdmitted
from fsar_ledger.events.world import ObstructionAppeared
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.fsar.execution import DecideOwnStep
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import DetectObstruction, ResumeAction, StartAction, TakeTurn
from fsar_ledger.runtime.handlers.request import RequestCapability
from tests import past
from tests.runtime.histories import DOOR, A, B, C, given, types
from tests.runtime.live import play

OPEN = msgspec.structs.replace(past.advertised(B, DOOR), override_allowed="emergency-only")
ASK = RequestCapability(A, B, DOOR, "visit", "q1")
GRANT = past.granted(C, None, "emergency-only")


def urgent(level: OverrideLevel, name: str = "q2") -> RequestCapability:
    """C1 asks the same robot, with this override level."""
    return RequestCapability(C, B, DOOR, "rounds", name, level)


def busy(*before: Any, stage: str = "running", level: OverrideLevel = "none") -> State:
    """B1 serves q1 of A1."""
    state = given("fsar", OPEN, *before)
    play(state, msgspec.structs.replace(ASK, override=level), EvaluateRequest("q1"))
    if stage != "queued":
        play(state, TakeTurn("q1"))
    if stage == "running":
        play(state, StartAction("q1", now_us=1_000_000, answer=2_000_000))
    return state


@pytest.mark.parametrize("level", ["none", "soft-priority"])
def test_a_weak_request_never_interrupts(level: OverrideLevel) -> None:
    found = types(play(busy(), urgent(level), EvaluateRequest("q2", now_us=1_500_000)))
    assert found == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


def test_soft_priority_goes_ahead_of_what_waits_without_it() -> None:
    state = busy()
    for level, name in (("none", "q2"), ("soft-priority", "q3"), ("soft-priority", "q4"), ("none", "q5")):
        play(state, urgent(level, name), EvaluateRequest(name))  # type: ignore[arg-type]
    assert (state.execution.current[B], state.execution.queues[B]) == ("q1", ("q3", "q4", "q2", "q5"))


def test_hard_preempt_takes_the_robot_and_the_preempted_action_keeps_its_rest_its_claims_and_its_place() -> None:
    state = busy()
    play(state, urgent("none", "q0"), EvaluateRequest("q0"))
    admitted, preempted, queued = play(state, urgent("hard-preempt"), EvaluateRequest("q2", now_us=1_500_000))
    assert isinstance(admitted, RequestAdmitted)
    assert preempted == ExecutionPreempted(Subject("visit", "q1"), B, "q2", 1_500_000)
    assert isinstance(queued, ExecutionQueued)
    assert (state.execution.current[B], state.execution.queues[B]) == ("q2", ("q1", "q0"))
    kept = state.authority.claims["q1"]
    claimed = [event for event in play(state, TakeTurn("q2")) if isinstance(event, AuthorityClaimed)]
    found = [(claim.dimension, claim.claimant) for claim in claimed]
    assert found == [("execution", "robot/B1"), ("override", "robot/B1")]
    assert state.authority.claims["q1"] == kept != ()
    assert play(state, ResumeAction("q1")) == (), "not before the robot is free"
    apply(state, past.finished(Subject("rounds", "q2"), B, C))
    [resumed] = play(state, ResumeAction("q1", now_us=4_000_000))
    assert resumed == ExecutionResumed(Subject("visit", "q1"), B, 5_500_000)


def test_what_was_preempted_on_its_way_is_on_its_way_again_and_is_accepted_once() -> None:
    state = busy(stage="approaching")
    _, preempted, _ = play(state, urgent("hard-preempt"), EvaluateRequest("q2"))
    assert preempted.remaining_us is None
    assert play(state, StartAction("q1", answer=5)) == (), "it is not there"
    apply(state, past.finished(Subject("rounds", "q2"), B, C))
    assert play(state, StartAction("q1", answer=5)) == (), "the way back comes first"
    assert types(play(state, TakeTurn("q1"))) == ["ApproachStarted"]
    assert len(state.authority.claims["q1"]) == 2
    assert types(play(state, StartAction("q1", answer=5))) == ["ExecutionStarted"]


def test_what_was_preempted_before_its_turn_is_accepted_at_its_turn() -> None:
    state = busy(stage="queued")
    play(state, urgent("hard-preempt"), EvaluateRequest("q2"))
    assert play(state, TakeTurn("q1")) == ()
    apply(state, past.finished(Subject("rounds", "q2"), B, C))
    found = types(play(state, TakeTurn("q1")))
    assert found == ["RequestAccepted", "AuthorityClaimed", "AuthorityClaimed", "ApproachStarted"]


def test_equals_do_not_interrupt_each_other_and_emergency_interrupts_all() -> None:
    state = busy(GRANT, level="hard-preempt")
    assert "ExecutionPreempted" not in types(play(state, urgent("hard-preempt"), EvaluateRequest("q2")))
    assert "ExecutionPreempted" in types(play(state, urgent("emergency-only", "q3"), EvaluateRequest("q3")))
    assert (state.execution.current[B], state.execution.queues[B]) == ("q3", ("q1", "q2"))


def test_emergency_without_a_supervisors_grant_is_no_override_at_all() -> None:
    state = busy()
    admitted, deferred, queued = play(state, urgent("emergency-only"), EvaluateRequest("q2"))
    assert (admitted.override, type(deferred).__name__, queued.override) == ("none", "RequestDeferred", "none")
    weaker = msgspec.structs.replace(GRANT, override="hard-preempt")
    state = busy(weaker)
    assert play(state, urgent("emergency-only"), EvaluateRequest("q2"))[0].override == "none"


def test_a_robot_that_helps_another_is_not_interrupted() -> None:
    help_given = past.assisted(Subject("t", "t/1"), A, B, past.principals(B, A, A))
    state = given("fsar", OPEN, help_given)
    events = play(state, urgent("hard-preempt"), EvaluateRequest("q2"))
    assert types(events) == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


def test_what_was_replanning_keeps_its_rest_and_no_early_plan_takes_the_robot_back() -> None:
    state = busy()
    apply(state, ExecutionPaused(Subject("visit", "q1"), B, 700_000))
    _, preempted, _ = play(state, urgent("hard-preempt"), EvaluateRequest("q2", now_us=1_900_000))
    assert preempted.remaining_us == 700_000
    assert play(state, ResumeAction("q1", now_us=2_300_000)) == ()
    apply(state, past.finished(Subject("rounds", "q2"), B, C))
    [resumed] = play(state, ResumeAction("q1", now_us=4_000_000))
    assert resumed.ends_us == 4_700_000


def test_a_failure_is_first_handled_by_the_executors_own_recovery() -> None:
    state = busy()
    apply(state, ObstructionAppeared(B, "o"))
    assert types(play(state, DetectObstruction("q1", now_us=1_500_000))) == ["ExecutionFailed"]
    found = types(play(state, urgent("hard-preempt"), EvaluateRequest("q2")))
    assert found == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


def test_an_own_step_that_was_preempted_while_policy_held_it_does_not_start_behind_the_other() -> None:
    own = past.began(Subject("B1-1", "B1-1/1.1"), B, 1, "navigate.indoor")
    arrived = past.arrived("B1-1", B, ("B navigate.indoor",))
    rule = past.ruled("deny", B, "navigate.indoor")
    state = given("fsar", OPEN, rule, arrived, own)
    assert types(play(state, DecideOwnStep("B1-1/1.1"), StartAction("B1-1/1.1", answer=5))) == ["ExecutionHeld"]
    assert "ExecutionPreempted" in types(play(state, urgent("hard-preempt"), EvaluateRequest("q2")))
    apply(state, msgspec.structs.replace(rule, outcome="allow"))
    assert play(state, StartAction("B1-1/1.1", answer=5)) == ()
    apply(state, past.finished(Subject("rounds", "q2"), B, C))
    assert types(play(state, StartAction("B1-1/1.1", answer=5))) == ["ExecutionStarted"]
