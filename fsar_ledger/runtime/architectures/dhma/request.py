"""DHMA: a delegated step is a contract net between agents. Paper: sec:evaluation:baselines."""

from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Parties, PolicyOutcome, Principal, Principals, Robot, agent
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    ContractVoided,
    GapDetected,
    RequestAccepted,
    RequestAdmitted,
    RequestClosed,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestUnanswered,
    SegmentTransferred,
)
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import is_asked
from fsar_ledger.projections.world import World, is_linked
from fsar_ledger.runtime.handlers import task
from fsar_ledger.runtime.handlers.attribution import capable, is_idle, pending_of_other_task, recorded_by
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    BeginStep,
    CloseExecution,
    CloseRequest,
    Command,
    CompleteStep,
    Decide,
    Handlers,
    React,
    Scheduled,
    at_once,
    begin_again,
    commanded_robot,
    message,
    open_request,
    requester,
    target,
)
from fsar_ledger.runtime.handlers.execution import queued
from fsar_ledger.runtime.handlers.task import TransferSegment, segment_message, transferred
from fsar_ledger.runtime.ports import Ask

from .agents import CALL, EVALUATION, OWN_RESULT, RELAY, RESULT, VOIDING, path, snapshot, talk

HANDLERS = Handlers()


class CallForProposals(ActionCommand):
    """Deliver the planner's call to the communication agent."""


class EvaluateBid(ActionCommand):
    """Judge the call by the snapshot of a candidate's planner."""

    robot: Robot


class ReceiveBid(ActionCommand):
    """Deliver a relayed bid to the requester's planner."""

    robot: Robot
    outcome: PolicyOutcome


class Award(ActionCommand):
    """Award the contract when all bids are in, or when H_F has approved the one under review."""


class CloseBidding(ActionCommand):
    """End the time in which the calls of this round should have been delivered.

    `is_last`: every robot that was reached in time has judged the call as well.
    """

    round: int
    is_last: bool = False


class GoOnWithout(ActionCommand):
    """Stop waiting for the robot that was awarded the contract in this round."""

    round: int


class AcceptAward(ActionCommand):
    """Deliver the award to the executor's communication agent."""


def best_bid(request: Request) -> tuple[Robot, PolicyOutcome] | None:
    """Return the first bid that allows, else the first under review, else None."""
    for preferred in ("allow", "review"):
        for robot, outcome in request.bids.items():
            if outcome == preferred:
                return robot, outcome
    return None


@HANDLERS.decide_on(open_request, CallForProposals, requester)
def call_for_proposals(state: State, _command: CallForProposals, request: Request) -> tuple[Event, ...]:
    """Call every capable robot."""
    robot = request.requester
    candidates = capable(state.fleet, state.registry, request.capability, robot)
    parties = _parties(state, request, robot, None)  # the award decides the executor
    return (
        RegistryQueried(
            subject=request.subject, principals=parties, capability=request.capability, candidates=candidates
        ),
        RequestIssued(
            subject=request.request_subject,
            principals=parties.decided(*path(robot, CALL)),
            capability=request.capability,
        ),
    )


@HANDLERS.decide_on(open_request, EvaluateBid, commanded_robot)
def evaluate_bid(state: State, command: EvaluateBid, request: Request) -> tuple[Event, ...]:
    """Bid by the snapshot of the candidate's planner, without naming the agent that would execute."""
    robot, outcome = command.robot, snapshot(state, command.robot, request.capability, request.task_id)
    parties = _parties(state, request, robot, None)  # a candidate is not yet the executor
    principals = parties.decided(*path(robot, EVALUATION))
    bid = BidSubmitted(request.task_id, parties, robot, outcome)
    if outcome == "deny":
        return (RequestDenied(request.request_subject, principals, "bid"), bid)
    return (RequestAdmitted(subject=request.request_subject, principals=principals, outcome=outcome), bid)


@HANDLERS.decide_on(open_request, ReceiveBid, requester)
def receive_bid(_state: State, command: ReceiveBid, request: Request) -> tuple[Event, ...]:
    """Record the bid at the requester's planner."""
    if request.is_unanswered:
        return ()
    return (BidReceived(request.subject, command.robot, command.outcome),)


@HANDLERS.decide(Award, requester)
def award(state: State, command: Award) -> tuple[Event, ...]:
    """Award the contract, or submit the best bid to H_F for review."""
    request = state.request.open.get(command.action_id)
    best = best_bid(request) if request is not None else None
    if (
        request is None
        or best is None
        or request.target is not None
        or is_asked(state.supervision, command.action_id, "review")
    ):
        return ()
    if best[1] == "review" and command.action_id not in state.supervision.approved:
        return (SupervisorCalled(subject=request.subject, supervisor=FLEET_SUPERVISOR, purpose="review"),)
    parties = _parties(state, request, request.requester, None)
    return (AwardMade(request.task_id, parties, best[0]),)


@HANDLERS.decide_on(open_request, CloseBidding, requester)
def close_bidding(state: State, command: CloseBidding, request: Request) -> tuple[Event, ...]:
    """Count robots that the call did not reach in time as refusals, and award to the best of the others.

    The request is unanswered if no robot is left. A bid under way is waited for, and so is a robot that the call has
    reached but whose agents are still judging it. Reading: R44.
    """
    if (
        request.is_unanswered
        or request.round != command.round
        or len(request.bids) == len(request.candidates)
        or request.underway
    ):
        return ()
    if not command.is_last and _may_answer(state.world, request):
        return ()
    if best_bid(request) is not None:
        return award(state, Award(command.action_id, now_us=command.now_us))
    return (_unanswered(state, request, None),)


def _may_answer(world: World, request: Request) -> bool:
    """Return whether a called robot without a bid can still be reached."""
    missing = len(request.candidates) - len(request.bids)
    return missing > len(world.off) + len(world.unlinked) or any(
        is_linked(world, robot) for robot in request.candidates if robot not in request.bids
    )


@HANDLERS.decide_on(open_request, GoOnWithout, requester)
def go_on_without(state: State, command: GoOnWithout, request: Request) -> tuple[Event, ...]:
    """Void an award that was not accepted in time; the step is tried again later. Reading: R44."""
    if request.round != command.round or request.target is None or request.is_accepted:
        return ()
    return (_unanswered(state, request, request.target),)


def _unanswered(state: State, request: Request, executor: Robot | None) -> RequestUnanswered:
    robot = request.requester
    principals = _parties(state, request, robot, executor).decided(*path(robot, ("communication",)))
    return RequestUnanswered(request.subject, principals, request.capability)


@HANDLERS.decide_on(open_request, AcceptAward, target)
def accept_award(state: State, _command: AcceptAward, request: Request) -> tuple[Event, ...]:
    """Commit the executor; its communication agent claims execution until the planner acknowledges."""
    if request.target is None:
        return ()
    robot = request.target
    parties = _parties(state, request, robot, robot)
    principals = parties.decided(*path(robot, ("communication",)))  # the other agents have not heard of it yet
    events: list[Event] = [RequestAccepted(request.request_subject, principals)]
    if not is_idle(state.execution, robot):
        events.append(RequestDeferred(request.request_subject, principals))
    events.append(_claim(request, "execution", agent(robot, "communication"), "acceptance"))
    if pending_of_other_task(state.execution, robot, request.task_id) is not None:
        events.append(_claim(request, "override", agent(robot, "communication"), "double booking"))
        events.append(_claim(request, "override", agent(robot, "execution"), "double booking"))
    return (*events, queued(request, parties, robot))


def _claim(request: Request, dimension: Any, claimant: Principal, reason: str) -> AuthorityClaimed:
    return AuthorityClaimed(subject=request.subject, dimension=dimension, claimant=claimant, reason=reason)


def _parties(state: State, request: Request, keeper: Robot, executor: Robot | None) -> Parties:
    """Return the parties of a record of the request, under the supervisor of the robot that keeps it."""
    return recorded_by(state, keeper, requested_by=request.requester, executed_by=executor)


@HANDLERS.decide_on(open_request, CloseRequest, requester)
def close_request(state: State, _command: CloseRequest, request: Request) -> tuple[Event, ...]:
    """Close the request at the requester's communication agent."""
    if request.target is None:
        return ()
    parties = _parties(state, request, request.target, request.target)
    principals = parties.decided(*path(request.requester, ("communication",)))
    return (RequestClosed(request.request_subject, principals),)


LONGEST = 3  # a call delivered within the answer time, plus two hops, takes at most this many answer times


def call(fleet: Fleet, request: Request, robot: Robot, before: tuple[Ask, ...] = ()) -> Scheduled:
    """Deliver the call to the candidate, whose agents work out a bid. The waits `before` come first."""
    key = f"{request.action_id}/{request.round}/{robot}"
    delivery = (*before, message(request.requester, key, "call"))
    return Scheduled(EvaluateBid(request.action_id, robot), 0, (*delivery, *talk(fleet, EVALUATION, key, "evaluate")))


@HANDLERS.react(GapDetected)
def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    waits = talk(state.fleet, CALL, event.subject.action_id, 0)
    return (Scheduled(CallForProposals(event.subject.action_id), 0, waits),)


@HANDLERS.react(RegistryQueried)
def _on_call(state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    request = state.request.open[event.subject.action_id]
    calls = tuple(call(state.fleet, request, robot) for robot in event.candidates)
    return (*calls, *_closing(state.fleet, request, (at_once(request.requester),)))


def _closing(fleet: Fleet, request: Request, waits: tuple[Ask, ...]) -> tuple[Scheduled, ...]:
    """Schedule both ends of bidding.

    The first is when the calls should have been delivered; the last is later by the longest time that agents take to
    judge a delivered call.
    """
    answer_us = fleet.answer_us
    last = CloseBidding(request.action_id, request.round, is_last=True)
    return (
        Scheduled(CloseBidding(request.action_id, request.round), answer_us, waits),
        Scheduled(last, LONGEST * answer_us, waits),
    )


@HANDLERS.react(BidSubmitted)
def _on_bid(state: State, event: BidSubmitted, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(state.task[event.task_id].action_id) if event.task_id in state.task else None
    if request is None:
        return ()
    key = f"{request.action_id}/{request.round}/{event.robot}"
    delivery = ReceiveBid(request.action_id, event.robot, event.outcome)
    waits = (message(event.robot, key, "bid"), *talk(state.fleet, RELAY, key, "relay"))
    return (Scheduled(delivery, 0, waits),)


@HANDLERS.react(BidReceived)
def _on_bid_received(state: State, event: BidReceived, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open[event.subject.action_id]
    if len(request.bids) < len(request.candidates):  # it may be the last bid awaited
        return _closing(state.fleet, request, (at_once(request.requester),))
    if best_bid(request) is None:
        return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)
    return (Scheduled(Award(event.subject.action_id)),)


@HANDLERS.react(SupervisorResponded)
def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(event.subject.action_id)
    if event.purpose != "review" or request is None or not request.is_delegated:
        return ()
    delay_us = 1 if event.approves else state.fleet.structure.back_off_us
    return (Scheduled(Award(event.subject.action_id), delay_us, (at_once(event.principals.decided_by),)),)


@HANDLERS.react(AwardMade)
def _on_award(state: State, event: AwardMade, _now_us: int) -> tuple[Scheduled, ...]:
    awarded_task = state.task.get(event.task_id)
    if awarded_task is None:  # given up meanwhile
        return ()
    request = state.request.open[awarded_task.action_id]
    award_message = message(request.requester, request.action_id, f"award/{request.round}")
    return (
        Scheduled(AcceptAward(request.action_id), 0, (award_message,)),
        Scheduled(GoOnWithout(request.action_id, request.round), state.fleet.answer_us, (at_once(request.requester),)),
    )


@HANDLERS.react(RequestUnanswered)
def _on_unanswered(state: State, event: RequestUnanswered, _now_us: int) -> tuple[Scheduled, ...]:
    return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)


@HANDLERS.react(ContractVoided)
def _on_void(state: State, event: ContractVoided, _now_us: int) -> tuple[Scheduled, ...]:
    """Let both sides' agents agree that the contract is void, and negotiate again under the same action."""
    request = state.request.open[event.subject.action_id]
    key = f"{request.action_id}/{request.round}/void"
    delivered = (*talk(state.fleet, VOIDING, key, "void"), message(event.robot, key, "void"))
    agreement = (*delivered, *talk(state.fleet, RELAY, key, "again"))
    calls = tuple(call(state.fleet, request, robot, agreement) for robot in request.candidates)
    return (*calls, *_closing(state.fleet, request, agreement))


@HANDLERS.react(ExecutionFinished)
def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(event.subject.action_id)
    close = Scheduled(CloseExecution(event.subject.action_id))
    if request is None or request.step == 0:
        return (close,)
    agents = RESULT if request.is_delegated else OWN_RESULT
    waits = talk(state.fleet, agents, event.subject.action_id, "result")
    if not request.is_delegated:
        return (close, Scheduled(CompleteStep(event.subject.action_id), 0, waits))
    delivery = (*waits, message(event.robot, event.subject.action_id, 4))
    return (close, Scheduled(CloseRequest(event.subject.action_id), 0, delivery))


@HANDLERS.react(RequestClosed)
def _on_close(_state: State, event: RequestClosed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(CompleteStep(event.subject.action_id)),)


def transfer_segment(state: State, command: TransferSegment) -> tuple[Event, ...]:
    """Give the next segment to its robot, as decided by the planner."""

    def by_planner(before: Robot, then: Robot) -> Principals:
        return recorded_by(state, before, requested_by=before, executed_by=then).decided(*path(before, CALL))

    return transferred(state, command, by_planner)


def _on_transfer(state: State, event: SegmentTransferred, _now_us: int) -> tuple[Scheduled, ...]:
    """Pass the segment from planner to planner."""
    transfer, key = segment_message(state, event), f"{event.task_id}/{event.step}"
    waits = (*talk(state.fleet, CALL, key, "handed"), transfer, *talk(state.fleet, RELAY, key, "taken"))
    return (Scheduled(BeginStep(event.task_id), 0, waits),)


OWN: dict[type[Command], Decide] = {TransferSegment: transfer_segment}
INSTEAD: dict[React, React] = {task.on_transfer: _on_transfer}
