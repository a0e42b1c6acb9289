"""JADE: a failure goes to the initiator, which calls again; there is no recovery and nobody above."""

import msgspec
import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import ExecutionFailed, ExecutionStarted, ExecutionWithdrawn
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryEscalated
from fsar_ledger.events.request import ContractVoided, RequestIssued
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import ObstructionAppeared
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.jade import DecideOwnStep, GiveUp, ReceiveFailure
from fsar_ledger.runtime.architectures.jade.contract_net import CallForProposals, EvaluateCall
from fsar_ledger.runtime.handlers.commands import BeginStep, DetectObstruction, StartAction, TakeTurn
from fsar_ledger.runtime.simulation import SCENARIOS
from tests.runtime.architectures.jade_runs import (
    ABOUT,
    ACTION,
    B2,
    LISTED,
    STEP,
    TASK,
    TWO_LISTED,
    A,
    B,
    C,
    S,
    contracted,
    follows,
    given,
    play,
    ran,
    reactions,
    scenario,
)
from tests.runtime.histories import ARRIVED, OWN_STEP
from tests.runtime.live import of


def failing(*before: Event, **dials: int) -> State:
    """The contractor has failed, and has given up."""
    state = contracted(ObstructionAppeared(B, "o"), *before, **dials)
    play(state, TakeTurn(ACTION), StartAction(ACTION, now_us=9 * S, answer=2 * S))
    play(state, DetectObstruction(ACTION, now_us=10 * S), GiveUp(ACTION, 1))
    return state


def test_a_failure_goes_to_the_initiator_and_ends_the_contract() -> None:
    state = failing()
    assert state.authority.claims.get(ACTION, ()) == ()
    [void] = play(state, ReceiveFailure(ACTION, B, 0))
    assert void == ContractVoided(ABOUT, B)
    assert follows(state, void) == [CallForProposals(ACTION)]


def test_the_message_of_a_failure_comes_from_the_contractor_and_that_of_an_own_step_is_not_sent() -> None:
    state = contracted(ObstructionAppeared(B, "o"))
    play(state, TakeTurn(ACTION), StartAction(ACTION, now_us=9 * S, answer=2 * S))
    [failed] = play(state, DetectObstruction(ACTION, now_us=10 * S))
    [_, told] = reactions(state, failed)
    assert [ask.sender for ask in told.waits] == [B]
    own = given(ARRIVED, OWN_STEP, ObstructionAppeared(A, "o"))
    play(own, DecideOwnStep(STEP), StartAction(STEP, now_us=9 * S, answer=2 * S))
    [failed] = play(own, DetectObstruction(STEP, now_us=10 * S))
    assert follows(own, failed) == [GiveUp(STEP, 1)]


def called_after_failure(*candidates: Robot) -> list[Robot]:
    state = given(*LISTED[:-1], msgspec.structs.replace(TWO_LISTED, candidates=candidates), ContractVoided(ABOUT, B))
    [issued] = play(state, CallForProposals(ACTION))
    return [one.robot for one in follows(state, issued) if isinstance(one, EvaluateCall)]


def test_the_next_round_goes_to_the_rest_and_else_to_the_same_robot_again() -> None:
    assert called_after_failure(B, C) == [C]
    assert called_after_failure(B) == [B]


@pytest.mark.parametrize("rounds", [1, 2, 4])
def test_the_initiator_iterates_up_to_the_dial_and_then_tries_the_step_anew(rounds: int) -> None:
    way = [(S, TASK), (S + 1, ObstructionAppeared(B, "o"))]
    run = ran(way, size=4, rounds=rounds)
    issued = [event.subject.action_id for _, event in of(run, RequestIssued)]
    assert issued[:rounds] == ["A1-1/1.1"] * rounds
    assert set(issued[rounds : 2 * rounds]) == {"A1-1/1.2"}


def test_another_contractor_does_the_step_from_the_beginning() -> None:
    run = ran([(S, TASK), (S + 1, ObstructionAppeared(B, "o"))])
    [first, then] = [event for _, event in of(run, ExecutionStarted)]
    assert (first.robot, then.robot, first.subject) == (B, B2, then.subject)
    assert of(run, TaskCompleted)


def test_the_protocol_has_no_level_of_recovery_and_no_supervisor() -> None:
    found = [event for name in SCENARIOS for run in range(3) for event in scenario(name, 4, None, run)]
    assert any(isinstance(event, ExecutionFailed) for event in found)
    never = (SupervisorCalled, FailureResolved, RecoveryAttempted, RecoveryEscalated)
    assert not any(isinstance(event, never) for event in found)


def test_a_failure_that_was_given_up_is_not_being_recovered_any_more() -> None:
    assert failing().recovery == {}


def test_a_step_of_its_own_that_failed_is_tried_anew_after_the_back_off() -> None:
    state = given(ARRIVED, OWN_STEP, ObstructionAppeared(A, "o"))
    play(state, DecideOwnStep(STEP), StartAction(STEP, now_us=9 * S, answer=2 * S))
    play(state, DetectObstruction(STEP, now_us=10 * S))
    [withdrawn] = play(state, GiveUp(STEP, 1))
    assert withdrawn == ExecutionWithdrawn(Subject("A1-1", STEP), A, 1)
    assert BeginStep("A1-1", STEP) in follows(state, withdrawn)
