"""JADE: a robot does its own steps alone, and what it has promised by itself.

Its own policy is asked once: when it decides about a step of its own, or proposes to do another's (`contract_net`).
What starts later starts, whatever has become of policy since; nobody knows the fleet's rule, and no agent asks for its
owner's consent, so a review means no. A rule that the fleet declares is therefore broken here, and so is a window that
opens between the proposal and the start: such a number is structural. JADE says nothing of motions: ours is that the
robot looks at its own policy before each.

A change of context pauses a robot until it has planned again, and leaves the contract standing: the protocol knows no
renegotiation after the acceptance (FIPA SC00029H).
"""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Parties, Principals, RequestSubject, Robot
from fsar_ledger.events.execution import (
    ExecutionPaused,
    ExecutionQueued,
    OwnStepDecided,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import ContextChanged
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Command,
    Decide,
    DecideRoutine,
    Handlers,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    begin_again,
    body,
    named,
    open_request,
    requester,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, queued, started, waiting
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.task import TransferSegment, transferred

from .directory import recorded

HANDLERS = Handlers()

OWN_STEP = "own step"  # why a step of the robot's own is denied: by its own policy


class DecideOwnStep(ActionCommand):
    """Decide about a step of the robot's own."""


def queued_for(state: State, request: Request, parties: Parties, robot: Robot) -> ExecutionQueued:
    """Return the fact that the robot has the action in its queue. An outsider's is no step, and has no approach."""
    is_step = request.step > 0
    return msgspec.structs.replace(
        queued(request, parties, robot, is_supervised=bool(state.fleet.jade.owner_is_named)),
        is_delegated=request.is_delegated and is_step,
        has_approach=request.is_delegated and is_step,
    )


@HANDLERS.decide_on(open_request, DecideOwnStep, requester)
def decide_own_step(state: State, _command: DecideOwnStep, request: Request) -> tuple[Event, ...]:
    """Decide to do the step if the robot's own policy allows it now; else it is tried again after the back-off."""
    robot = request.requester
    parties = recorded(state, robot, requested_by=robot, executed_by=robot)
    principals = parties.decided(robot)
    if own_policy(state.policy, state.world, robot, request.capability, request.task_id) != "allow":
        return (RequestDenied(RequestSubject(request.task_id, request.action_id, None), principals, OWN_STEP),)
    decided = OwnStepDecided(request.subject, principals, request.capability)
    return (decided, queued_for(state, request, parties, robot))


@HANDLERS.decide(StartAction, body)
def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the execution, without another look at policy."""
    action = waiting(state.execution, command.action_id)
    return () if action is None else (started(state, action, command),)


@HANDLERS.decide(DecideRoutine, named)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; a motion only if the robot's own policy allows it."""
    robot = command.robot
    principals = recorded(state, robot, requested_by=robot, executed_by=robot).decided(robot)
    is_free = command.operation == "sensing" or own_policy(state.policy, state.world, robot, None, None) == "allow"
    kind = RoutinePerformed if is_free else RoutineWithheld
    return (kind(principals, robot, command.operation),)


def transfer_segment(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot, by word of the robot that acted until then."""

    def by_it(before: Robot, then: Robot) -> Principals:
        return recorded(state, before, requested_by=before, executed_by=then).decided(before)

    return transferred(state, command, by_it)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DecideOwnStep(event.subject.action_id)),) if event.target_role is None else ()


@HANDLERS.react(RequestDenied)
def _on_denial(state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    """Try a step of the robot's own again after the back-off; what an agent refuses, it says in its reply."""
    if event.reason != OWN_STEP or event.subject.task_id is None or event.subject.action_id is None:
        return ()
    return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(ResumeAction(event.subject.action_id), state.fleet.structure.replan_us),)


HANDLERS.decide(TakeTurn, body)(approach)
HANDLERS.react(ContextChanged)(pause_running)
OWN: dict[type[Command], Decide] = {TransferSegment: transfer_segment}
