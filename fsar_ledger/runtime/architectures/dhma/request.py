"""DHMA: a delegated step is a contract net between agents. Paper: sec:evaluation:baselines."""

from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Parties, PolicyOutcome, Principal, Robot, agent
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    GapDetected,
    RequestAccepted,
    RequestAdmitted,
    RequestClosed,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import is_asked
from fsar_ledger.projections.world import World, is_linked
from fsar_ledger.runtime.handlers.actors import named, requester, target
from fsar_ledger.runtime.handlers.attribution import capable, is_idle, pending_of_other_task, recorded_by
from fsar_ledger.runtime.handlers.commands import CloseRequest, Command, Handlers
from fsar_ledger.runtime.handlers.execution import queued

from .agents import snapshot
from .talk import CALL, EVALUATION, path

HANDLERS = Handlers()


class DetectGap(Command):
    """Detect that the step needs another robot."""

    action_id: str


class CallForProposals(Command):
    """Deliver the planner's wish to the communication agent."""

    action_id: str


class EvaluateBid(Command):
    """Judge the call by the snapshot of a candidate's planner."""

    action_id: str
    robot: Robot


class ReceiveBid(Command):
    """Deliver a relayed bid to the requester's planner."""

    action_id: str
    robot: Robot
    outcome: PolicyOutcome


class Award(Command):
    """Award the contract when all bids are in, or when H_F has approved the one under review."""

    action_id: str


class CloseBidding(Command):
    """End the time in which the calls of this round should have been delivered.

    `is_last`: all who were called in time have judged the call as well.
    """

    action_id: str
    round: int
    is_last: bool = False


class GoOnWithout(Command):
    """Stop waiting for the robot that was awarded the contract in this round."""

    action_id: str
    round: int


class AcceptAward(Command):
    """Deliver the award to the executor's communication agent."""

    action_id: str


def best_bid(request: Request) -> tuple[Robot, PolicyOutcome] | None:
    """Return the first bid that allows, else the first under review, else None."""
    for wanted in ("allow", "review"):
        for robot, outcome in request.bids.items():
            if outcome == wanted:
                return robot, outcome
    return None


@HANDLERS.decide(DetectGap, requester)
def detect_gap(state: State, command: DetectGap) -> tuple[Event, ...]:
    """Record the planner's finding that the step needs another robot."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    parties = _parties(state.fleet, state.world, request, request.requester, None)
    return (GapDetected(request.subject, parties, request.capability),)


@HANDLERS.decide(CallForProposals, requester)
def call_for_proposals(state: State, command: CallForProposals) -> tuple[Event, ...]:
    """Call every capable robot."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    robot = request.requester
    candidates = capable(state.fleet, state.registry, request.capability, robot)
    asking = _parties(state.fleet, state.world, request, robot, None)  # whoever is awarded executes
    return (
        RegistryQueried(
            subject=request.subject, principals=asking, capability=request.capability, candidates=candidates
        ),
        RequestIssued(
            subject=request.request_subject,
            principals=asking.decided(*path(robot, CALL)),
            capability=request.capability,
        ),
    )


@HANDLERS.decide(EvaluateBid, named)
def evaluate_bid(state: State, command: EvaluateBid) -> tuple[Event, ...]:
    """Bid by the snapshot of the candidate's planner, without naming the agent that would execute."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    robot, outcome = command.robot, snapshot(state.knowledge, command.robot)
    parties = _parties(state.fleet, state.world, request, robot, None)  # a candidate is not yet the executor
    judging = parties.decided(*path(robot, EVALUATION))
    decided: Event
    if outcome == "deny":
        decided = RequestDenied(request.request_subject, judging, "bid")
    else:
        decided = RequestAdmitted(subject=request.request_subject, principals=judging, outcome=outcome)
    return (decided, BidSubmitted(request.task_id, parties, robot, outcome))


@HANDLERS.decide(ReceiveBid, requester)
def receive_bid(state: State, command: ReceiveBid) -> tuple[Event, ...]:
    """Record the bid at the requester's planner."""
    request = state.request.open.get(command.action_id)
    return (
        ()
        if request is None or request.is_unanswered
        else (BidReceived(request.subject, command.robot, command.outcome),)
    )


@HANDLERS.decide(Award, requester)
def award(state: State, command: Award) -> tuple[Event, ...]:
    """Award the contract, or put the best bid before H_F."""
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
    parties = _parties(state.fleet, state.world, request, request.requester, None)
    return (AwardMade(request.task_id, parties, best[0]),)


@HANDLERS.decide(CloseBidding, requester)
def close_bidding(state: State, command: CloseBidding) -> tuple[Event, ...]:
    """Count robots that the call did not reach in time as refusals, and award to the best of the others.

    The request is unanswered if none is left. A bid that is on its way is waited for, and so is a robot that the call
    has reached but whose agents still judge it. Reading: R44.
    """
    request = state.request.open.get(command.action_id)
    if (
        request is None
        or request.is_unanswered
        or request.round != command.round
        or len(request.bids) == len(request.candidates)
        or request.underway
    ):
        return ()
    if not command.is_last and _may_answer(state.world, request):
        return ()
    if best_bid(request) is not None:
        return award(state, Award(command.action_id, now_us=command.now_us))
    return (_unanswered(state.fleet, state.world, request, None),)


def _may_answer(world: World, request: Request) -> bool:
    """Return whether a robot that was called, and whose bid is not there, can still be reached."""
    missing = len(request.candidates) - len(request.bids)
    return missing > len(world.off) + len(world.unlinked) or any(
        is_linked(world, robot) for robot in request.candidates if robot not in request.bids
    )


@HANDLERS.decide(GoOnWithout, requester)
def go_on_without(state: State, command: GoOnWithout) -> tuple[Event, ...]:
    """Void an award that was not accepted in time; the step is tried again later. Reading: R44."""
    request = state.request.open.get(command.action_id)
    if request is None or request.round != command.round or request.target is None or request.is_accepted:
        return ()
    return (_unanswered(state.fleet, state.world, request, request.target),)


def _unanswered(fleet: Fleet, world: World, request: Request, executor: Robot | None) -> RequestUnanswered:
    robot = request.requester
    principals = _parties(fleet, world, request, robot, executor).decided(*path(robot, ("communication",)))
    return RequestUnanswered(request.subject, principals, request.capability)


@HANDLERS.decide(AcceptAward, target)
def accept_award(state: State, command: AcceptAward) -> tuple[Event, ...]:
    """Commit the executor; its communication agent claims execution until the planner acknowledges."""
    request = state.request.open.get(command.action_id)
    if request is None or request.target is None:
        return ()
    robot = request.target
    parties = _parties(state.fleet, state.world, request, robot, robot)
    principals = parties.decided(*path(robot, ("communication",)))  # the other agents have still to hear of it
    made: list[Event] = [RequestAccepted(request.request_subject, principals)]
    if not is_idle(state.execution, robot):
        made.append(RequestDeferred(request.request_subject, principals))
    made.append(_claim(request, "execution", agent(robot, "communication"), "acceptance"))
    if pending_of_other_task(state.execution, robot, request.task_id) is not None:
        made += [
            _claim(request, "override", agent(robot, kind), "double booking") for kind in ("communication", "execution")
        ]
    return (*made, queued(request, parties, robot))


def _claim(request: Request, dimension: Any, claimant: Principal, reason: str) -> AuthorityClaimed:
    return AuthorityClaimed(request.subject, dimension, claimant, reason)


def _parties(fleet: Fleet, world: World, request: Request, near: Robot, executor: Robot | None) -> Parties:
    """Return whom a record of the request names, under the supervisor of the robot that keeps it."""
    return recorded_by(fleet, world, near, requested_by=request.requester, executed_by=executor)


@HANDLERS.decide(CloseRequest, requester)
def close_request(state: State, command: CloseRequest) -> tuple[Event, ...]:
    """Close the request at the requester's communication agent."""
    request = state.request.open.get(command.action_id)
    if request is None or request.target is None:
        return ()
    parties = _parties(state.fleet, state.world, request, request.target, request.target)
    principals = parties.decided(*path(request.requester, ("communication",)))
    return (RequestClosed(request.request_subject, principals),)
