"""JADE: agents that find each other in yellow pages and award work by the FIPA contract net.

Sources: JADE 4.6.5 (`src/jade/...`, as named in each module) and the FIPA standards SC00029H (contract net) and
SC00030H (iterated contract net). What they leave open is a dial (`designs.dials.Jade`) or a choice of ours, stated
where it is made. JADE does not mention robots: one agent per robot is the plainest reading, four are DHMA's choice.
Paper: tab:baseline_context.

This module holds what a robot does alone: its own steps, its contracts, its failures, and calls without trust.

Its own policy is checked once: when it decides about a step of its own, or proposes to do another's (`contract_net`).
A later start ignores any change of policy since; no agent knows the fleet's rule or asks for its owner's consent, so a
review means no. A rule that the fleet declares is therefore broken here, and so is a window that opens between the
proposal and the start: such a number is structural. JADE does not mention motions: our choice is that the robot checks
its own policy before each.

A change of context pauses a robot until it has replanned, and leaves the contract in force: the protocol has no
renegotiation after the acceptance (FIPA SC00029H).

A failure ends the contract and goes to the initiator, which calls for proposals again. The contractor sends FAILURE
(`jade/proto/ContractNetResponder.java`) and is done with the action; `handleFailure` of the initiator is an empty
hook, and the protocol has no recovery, no supervisor and no level of recovery. So nothing here resolves a failure: it
stays unresolved on record, even if another contractor then does the step from the beginning. (Containment is
therefore 0 by construction, and reassignment latency has no value.) The next round is FIPA's iterated contract net
(SC00030H; `newIteration`): a cfp to the other agents that are listed, else to the same ones again. After the dial
`rounds` the step is retried, after the back-off (ours). So is a step of the robot's own, which has no other agent to
call (ours).

An untrusted robot is served like any other. The yellow pages show every entry to every agent, and base JADE has no
permissions, so an outsider's call reaches the agent; it is served if that agent's own policy allows. With JADE-S (dial
`permissions`) it is refused. The outsider names the agent itself, so it calls that one, without a search.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Principals, RequestSubject, Robot
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionPaused,
    ExecutionWithdrawn,
    OwnStepDecided,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.request import ContractVoided, RequestDenied
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import ContextChanged, OutsiderRequestInjected
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Command,
    Decide,
    DecideRoutine,
    Handlers,
    Scheduled,
    StartAction,
    TakeTurn,
    begin_again,
    body,
    commanded_robot,
    known_action,
    message,
    open_request,
    requester,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, resume_when_replanned, start
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.task import TransferSegment, transferred

from . import contract_net, directory
from .contract_net import CallForProposals, queued_for
from .directory import recorded

HANDLERS = Handlers()

OWN_STEP = "own step"  # reason for denying a step of the robot's own: its own policy


class DecideOwnStep(ActionCommand):
    """Decide about a step of the robot's own."""


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


@HANDLERS.decide(DecideRoutine, commanded_robot)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; a motion only if the robot's own policy allows it."""
    robot = command.robot
    principals = recorded(state, robot, requested_by=robot, executed_by=robot).decided(robot)
    is_free = command.operation == "sensing" or own_policy(state.policy, state.world, robot, None, None) == "allow"
    kind = RoutinePerformed if is_free else RoutineWithheld
    return (kind(principals, robot, command.operation),)


def transfer_segment(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot, on the authority of the robot that acted until then."""

    def by_it(before: Robot, then: Robot) -> Principals:
        return recorded(state, before, requested_by=before, executed_by=then).decided(before)

    return transferred(state, command, by_it)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DecideOwnStep(event.subject.action_id)),) if event.target_role is None else ()


@HANDLERS.react(RequestDenied)
def _on_denial(state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    """Retry a step of the robot's own after the back-off; an agent states a refusal in its reply."""
    if event.reason != OWN_STEP or event.subject.task_id is None or event.subject.action_id is None:
        return ()
    return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)


HANDLERS.decide(TakeTurn, body)(approach)
HANDLERS.decide(StartAction, body)(start)
HANDLERS.react(ExecutionPaused)(resume_when_replanned)
HANDLERS.react(ContextChanged)(pause_running)
OWN: dict[type[Command], Decide] = {TransferSegment: transfer_segment}


class GiveUp(ActionCommand):
    """Give up the action that has failed."""

    failure: int


class ReceiveFailure(ActionCommand):
    """Deliver the contractor's FAILURE to the initiator."""

    robot: Robot
    round: int


@HANDLERS.decide_on(known_action, GiveUp, body)
def give_up(state: State, command: GiveUp, action: Action) -> tuple[Event, ...]:
    """End the robot's claim and free it: its progress on the action is lost."""
    if action.stage != "failed" or action.failures != command.failure:
        return ()
    withdrawn = ExecutionWithdrawn(action.subject, action.robot, command.failure)
    return (*release(state.authority, action.action_id), withdrawn)


@HANDLERS.decide_on(open_request, ReceiveFailure, requester)
def receive_failure(_state: State, command: ReceiveFailure, request: Request) -> tuple[Event, ...]:
    """End the contract with the robot that has failed."""
    if command.round != request.round:
        return ()
    return (ContractVoided(request.subject, command.robot),)


@HANDLERS.react(ExecutionFailed)
def _on_failure(state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    action_id = event.subject.action_id
    given_up, request = Scheduled(GiveUp(action_id, event.failure)), state.request.open.get(action_id)
    if request is None or not request.is_delegated:
        return (given_up,)
    report = message(event.robot, f"{action_id}/{event.failure}", "report")
    return (given_up, Scheduled(ReceiveFailure(action_id, event.robot, request.round), 0, (report,)))


@HANDLERS.react(ContractVoided)
def _on_void(state: State, event: ContractVoided, _now_us: int) -> tuple[Scheduled, ...]:
    """Call the other agents, unless the task is over or this was the last round."""
    request = state.request.open.get(event.subject.action_id)
    if request is None or request.task_id not in state.task:
        return ()
    if request.round < state.fleet.jade.rounds:
        return (Scheduled(CallForProposals(request.action_id)),)
    return (begin_again(state.fleet, request.task_id, request.action_id),)


@HANDLERS.react(ExecutionWithdrawn)
def _on_withdrawal(state: State, event: ExecutionWithdrawn, _now_us: int) -> tuple[Scheduled, ...]:
    """Retry a step of the robot's own, which it gave up, after the back-off."""
    request = state.request.open.get(event.subject.action_id)
    if event.failure is None or request is None or request.is_delegated:
        return ()
    return (begin_again(state.fleet, request.task_id, request.action_id),)


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(CallForProposals(event.task_id)),)


JADE: HandlerTable = HandlerTable.of(*COMMON, directory, contract_net, HANDLERS, own=OWN)
