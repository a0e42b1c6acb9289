"""JADE: a delegated step is a FIPA contract net between the agents of two robots.

A call for proposals (cfp) goes to every agent that the yellow pages list; each proposes or refuses; one proposal is
accepted and the others are rejected; the contractor informs of the result at the end
(`jade/proto/ContractNetInitiator.java`, `ContractNetResponder.java`; FIPA SC00029H).

- A bidder checks its own policy as it is then, and nothing else: the cfp carries no policy of the initiator, and no
  agent knows the fleet's rule. A review means refuse: the protocol has no reviewer.
- The initiator waits for all replies or until the reply-by. Without one it waits forever (deadline -1). Later replies
  are out of sequence and ignored (`checkSessions`).
- An acceptance made by `createReply` has no reply-by of its own (`jade/lang/acl/ACLMessage.java`), so the initiator
  waits for the result forever.
- The standard leaves the evaluation of proposals open. Ours: a proposal says how many actions come first in the
  bidder's own queue (there are no positions, and no agent foresees how long work takes), and the initiator accepts the
  one with the fewest; among equals, the first received.
- With JADE-S (dial `permissions`), only a sender with permission reaches an agent (`AgentPermission`, `send-to`).
"""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import REGISTRY, Parties, PolicyOutcome, Robot
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    ContractVoided,
    MessageUndelivered,
    RequestAccepted,
    RequestAdmitted,
    RequestClosed,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestUnanswered,
)
from fsar_ledger.projections.execution import Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import is_linked
from fsar_ledger.runtime.handlers.attribution import is_idle
from fsar_ledger.runtime.handlers.authority import close_execution
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    CloseExecution,
    CloseRequest,
    CompleteStep,
    Handlers,
    Scheduled,
    begin_again,
    commanded_robot,
    message,
    nobody,
    open_request,
    requester,
    target,
)
from fsar_ledger.runtime.handlers.execution import queued
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.trust import trusts

from .directory import awaits_delivery, called, recorded

HANDLERS = Handlers()


class CallForProposals(ActionCommand):
    """Send the cfp to every agent that is called in this round."""


class EvaluateCall(ActionCommand):
    """Deliver the cfp to a candidate, which proposes or refuses."""

    robot: Robot
    round: int


class ReceiveReply(ActionCommand):
    """Deliver a proposal or a refusal to the initiator."""

    robot: Robot
    round: int
    outcome: PolicyOutcome
    ahead: int | None


class EvaluateProposals(ActionCommand):
    """Evaluate the proposals when all replies are in, or (`is_deadline`) at the reply-by."""

    round: int
    is_deadline: bool = False


class ReceiveAcceptance(ActionCommand):
    """Deliver accept-proposal to the contractor."""

    round: int


class Bounce(ActionCommand):
    """Find that the node of the called or accepted robot is no longer on the platform."""

    robot: Robot
    round: int


class ReceiveUndelivered(ActionCommand):
    """Deliver the AMS's FAILURE to the initiator: its message did not reach the robot."""

    robot: Robot
    round: int


def is_waiting(request: Request) -> bool:
    """Return whether the initiator still waits for replies.

    An outsider's request has its candidate as the target from the start.
    """
    is_awarded = request.target is not None if request.step > 0 else request.is_accepted
    return not (request.is_unanswered or is_awarded)


def has_all_replies(request: Request) -> bool:
    """Return whether every call has ended: in a proposal, a refusal, or a FAILURE of the platform."""
    return all(robot in request.bids or robot in request.undelivered for robot in called(request))


def proposers(request: Request) -> list[Robot]:
    """Return the robots that have proposed, the one with the fewest actions ahead first, else the first received."""
    proposed = [robot for robot, outcome in request.bids.items() if outcome == "allow"]
    return sorted(proposed, key=lambda robot: request.ahead.get(robot, 0))


def actions_ahead(execution: Execution, robot: Robot) -> int:
    """Return how many actions come first at the robot: the one that holds it, and its queue."""
    return (robot in execution.current) + len(execution.queues.get(robot, ()))


def queued_for(state: State, request: Request, parties: Parties, robot: Robot) -> ExecutionQueued:
    """Return the event that queues the action at the robot. An outsider's is no step, and has no approach."""
    is_step = request.step > 0
    return msgspec.structs.replace(
        queued(request, parties, robot, is_supervised=bool(state.fleet.jade.owner_is_named)),
        is_delegated=request.is_delegated and is_step,
        has_approach=request.is_delegated and is_step,
    )


@HANDLERS.decide_on(open_request, CallForProposals, requester)
def call_for_proposals(state: State, _command: CallForProposals, request: Request) -> tuple[Event, ...]:
    """Call the candidates; without any, the step is retried after the back-off (ours)."""
    robot = request.requester
    principals = recorded(state, robot, requested_by=robot, executed_by=None).decided(robot)
    if not request.candidates:
        return (RequestUnanswered(request.subject, principals, request.capability),)
    return (RequestIssued(subject=request.request_subject, principals=principals, capability=request.capability),)


def refusal(state: State, request: Request, robot: Robot) -> str | None:
    """Return why the robot refuses the call, or None if it proposes."""
    about = (request.capability, request.task_id)
    if state.fleet.jade.permissions and not trusts(state, robot, request.requester, *about):
        return "permission"
    return None if own_policy(state.policy, state.world, robot, *about) == "allow" else "policy"


@HANDLERS.decide_on(open_request, EvaluateCall, commanded_robot)
def evaluate_call(state: State, command: EvaluateCall, request: Request) -> tuple[Event, ...]:
    """Propose or refuse by the robot's own policy as it is now; the message names its sender as the executor."""
    if command.round != request.round:
        return ()  # the conversation is over
    robot, reason = command.robot, refusal(state, request, command.robot)
    parties = recorded(state, robot, requested_by=request.requester, executed_by=robot)
    principals = parties.decided(robot)
    if reason is not None:
        denied = RequestDenied(request.request_subject, principals, reason)
        return (denied, BidSubmitted(request.task_id, parties, robot, "deny"))
    return (
        RequestAdmitted(subject=request.request_subject, principals=principals, outcome="allow"),
        BidSubmitted(request.task_id, parties, robot, "allow", actions_ahead(state.execution, robot)),
    )


@HANDLERS.decide_on(open_request, ReceiveReply, requester)
def receive_reply(_state: State, command: ReceiveReply, request: Request) -> tuple[Event, ...]:
    """Record the reply; one that is out of sequence is ignored."""
    if command.round != request.round or not is_waiting(request):
        return ()
    return (BidReceived(request.subject, command.robot, command.outcome, command.ahead),)


@HANDLERS.decide_on(open_request, EvaluateProposals, requester)
def evaluate_proposals(state: State, command: EvaluateProposals, request: Request) -> tuple[Event, ...]:
    """Accept one proposal and reject the others; at the reply-by, without waiting for those that have not replied."""
    if command.round != request.round or not is_waiting(request) or command.is_deadline == has_all_replies(request):
        return ()
    return _evaluated(state, request)


def _evaluated(state: State, request: Request) -> tuple[Event, ...]:
    robot, proposed = request.requester, proposers(request)
    if not proposed:
        principals = recorded(state, robot, requested_by=robot, executed_by=None).decided(robot)
        return (RequestUnanswered(request.subject, principals, request.capability),)
    parties = recorded(state, robot, requested_by=robot, executed_by=proposed[0])
    return (AwardMade(request.task_id, parties, proposed[0], tuple(proposed[1:])),)


@HANDLERS.decide_on(open_request, ReceiveAcceptance, target)
def receive_acceptance(state: State, command: ReceiveAcceptance, request: Request) -> tuple[Event, ...]:
    """Commit the contractor, which claims execution from here until it informs of the result."""
    robot = request.target
    if robot is None or command.round != request.round or request.is_accepted or robot in request.undelivered:
        return ()
    parties = recorded(state, robot, requested_by=request.requester, executed_by=robot)
    principals = parties.decided(robot)
    deferred = () if is_idle(state.execution, robot) else (RequestDeferred(request.request_subject, principals),)
    return (
        RequestAccepted(request.request_subject, principals),
        *deferred,
        AuthorityClaimed(subject=request.subject, dimension="execution", claimant=robot, reason="acceptance"),
        queued_for(state, request, parties, robot),
    )


@HANDLERS.decide_on(open_request, Bounce, nobody)
def bounce(state: State, command: Bounce, request: Request) -> tuple[Event, ...]:
    """Record the call or the acceptance as undeliverable, unless the robot can be reached again."""
    if command.round != request.round or is_linked(state.world, command.robot):
        return ()
    return (MessageUndelivered(request.subject, command.robot),) if awaits_delivery(request, command.robot) else ()


@HANDLERS.decide_on(open_request, ReceiveUndelivered, requester)
def receive_undelivered(state: State, command: ReceiveUndelivered, request: Request) -> tuple[Event, ...]:
    """End the contract that did not reach the contractor, or stop waiting for the reply of a robot out of reach."""
    if command.round != request.round or request.is_accepted:
        return ()
    if not is_waiting(request):
        return (ContractVoided(request.subject, command.robot),) if request.target == command.robot else ()
    return _evaluated(state, request) if has_all_replies(request) else ()


@HANDLERS.decide_on(open_request, CloseRequest, requester)
def close_request(state: State, _command: CloseRequest, request: Request) -> tuple[Event, ...]:
    """End the protocol with the contractor's inform."""
    if request.target is None:
        return ()
    parties = recorded(state, request.requester, requested_by=request.requester, executed_by=request.target)
    return (RequestClosed(request.request_subject, parties.decided(request.requester)),)


@HANDLERS.react(RegistryQueried)
def _on_answer(_state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    """Call once the DF's answer has arrived; a subscriber has it already."""
    assert event.subject.action_id is not None
    call = CallForProposals(event.subject.action_id)
    if event.as_of_us is not None:
        return (Scheduled(call),)
    return (Scheduled(call, 0, (message(REGISTRY, event.subject.action_id, 1),)),)


@HANDLERS.react(RequestIssued)
def _on_call(state: State, event: RequestIssued, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    request = state.request.open[event.subject.action_id]
    calls = []
    for robot in called(request):
        cfp = message(request.requester, f"{request.action_id}/{request.round}/{robot}", "call")
        calls.append(Scheduled(EvaluateCall(request.action_id, robot, request.round), 0, (cfp,)))
        if robot in state.registry.silent:
            calls.append(Scheduled(Bounce(request.action_id, robot, request.round)))
    reply_by_us = state.fleet.jade.reply_by_us
    if reply_by_us == 0:
        return tuple(calls)
    deadline = EvaluateProposals(request.action_id, request.round, is_deadline=True)
    return (*calls, Scheduled(deadline, reply_by_us))


@HANDLERS.react(BidSubmitted)
def _on_reply(state: State, event: BidSubmitted, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open[state.request.of_task[event.task_id]]
    reply = ReceiveReply(request.action_id, event.robot, request.round, event.outcome, event.ahead)
    key = f"{request.action_id}/{request.round}/{event.robot}"
    return (Scheduled(reply, 0, (message(event.robot, key, "bid"),)),)


@HANDLERS.react(BidReceived)
def _on_reply_received(state: State, event: BidReceived, _now_us: int) -> tuple[Scheduled, ...]:
    """Evaluate when all replies are in; if all have refused, the step is retried after the back-off (ours)."""
    request = state.request.open[event.subject.action_id]
    if not has_all_replies(request):
        return ()
    if not proposers(request):
        return (begin_again(state.fleet, request.task_id, request.action_id),)
    return (Scheduled(EvaluateProposals(request.action_id, request.round)),)


@HANDLERS.react(AwardMade)
def _on_award(state: State, event: AwardMade, _now_us: int) -> tuple[Scheduled, ...]:
    """Send the acceptance. The rejected robots had reserved nothing, so nothing follows from the rejection."""
    request = state.request.open[state.request.of_task[event.task_id]]
    accept = message(request.requester, request.action_id, f"award/{request.round}")
    delivery = Scheduled(ReceiveAcceptance(request.action_id, request.round), 0, (accept,))
    if event.robot not in state.registry.silent:
        return (delivery,)
    return (delivery, Scheduled(Bounce(request.action_id, event.robot, request.round)))


@HANDLERS.react(MessageUndelivered)
def _on_undelivered(state: State, event: MessageUndelivered, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open[event.subject.action_id]
    notice = message(None, f"{request.action_id}/{request.round}/{event.robot}", "undelivered")
    return (Scheduled(ReceiveUndelivered(request.action_id, event.robot, request.round), 0, (notice,)),)


@HANDLERS.react(RequestUnanswered)
def _on_unanswered(state: State, event: RequestUnanswered, _now_us: int) -> tuple[Scheduled, ...]:
    return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)


@HANDLERS.react(ExecutionFinished)
def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    """Inform the initiator; a step of the robot's own is then complete."""
    action_id = event.subject.action_id
    request, close = state.request.open.get(action_id), Scheduled(CloseExecution(action_id))
    if request is None:
        return (close,)
    if not request.is_delegated:
        return (close, Scheduled(CompleteStep(action_id)))
    return (close, Scheduled(CloseRequest(action_id), 0, (message(event.robot, action_id, 4),)))


@HANDLERS.react(RequestClosed)
def _on_close(_state: State, event: RequestClosed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(CompleteStep(event.subject.action_id)),)


HANDLERS.decide(CloseExecution, nobody)(close_execution)
