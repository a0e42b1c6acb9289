"""JADE: a failure ends the contract and goes to the initiator, which calls for proposals again.

The contractor sends FAILURE (`jade/proto/ContractNetResponder.java`) and has done with the action; `handleFailure` of
the initiator is an empty hook, and the protocol has no recovery, no supervisor and no level of recovery. So nothing
here resolves a failure: it stays unresolved on record, also where another contractor then does the step from the
beginning. (Containment is therefore 0 by construction, and reassignment latency has no value.)

The next round is FIPA's iterated contract net (SC00030H; `newIteration`): a cfp to the rest of the agents that are
listed, else to the same ones again. After the dial `rounds` the step is tried anew, after the back-off (ours). So is a
step of the robot's own, for which there is nobody to call (ours).
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionFailed, ExecutionWithdrawn
from fsar_ledger.events.request import ContractVoided
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Handlers,
    Scheduled,
    begin_again,
    body,
    known_action,
    message,
    open_request,
    requester,
)

from .contract_net import CallForProposals

HANDLERS = Handlers()


class GiveUp(ActionCommand):
    """Give up the action that has failed."""

    failure: int


class ReceiveFailure(ActionCommand):
    """Deliver the contractor's FAILURE to the initiator."""

    robot: Robot
    round: int


@HANDLERS.decide_on(known_action, GiveUp, body)
def give_up(state: State, command: GiveUp, action: Action) -> tuple[Event, ...]:
    """End the robot's claim and free it: what it had done of the action is lost."""
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
    told = message(event.robot, f"{action_id}/{event.failure}", "report")
    return (given_up, Scheduled(ReceiveFailure(action_id, event.robot, request.round), 0, (told,)))


@HANDLERS.react(ContractVoided)
def _on_void(state: State, event: ContractVoided, _now_us: int) -> tuple[Scheduled, ...]:
    """Call the rest, unless the task is over or this was the last round."""
    request = state.request.open.get(event.subject.action_id)
    if request is None or request.task_id not in state.task:
        return ()
    if request.round < state.fleet.jade.rounds:
        return (Scheduled(CallForProposals(request.action_id)),)
    return (begin_again(state.fleet, request.task_id, request.action_id),)


@HANDLERS.react(ExecutionWithdrawn)
def _on_withdrawal(state: State, event: ExecutionWithdrawn, _now_us: int) -> tuple[Scheduled, ...]:
    """Try a step of the robot's own, which it gave up, again after the back-off."""
    request = state.request.open.get(event.subject.action_id)
    if event.failure is None or request is None or request.is_delegated:
        return ()
    return (begin_again(state.fleet, request.task_id, request.action_id),)
