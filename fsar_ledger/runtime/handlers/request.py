"""Requests that a robot or its operator issues, answers to counter-offers, and reports of results.

These requests go the way of every other: the executor evaluates them under its own runtime. Paper:
sec:model:request.
"""

from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import OverrideLevel, RequestSubject, Result, Robot, Subject
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.request import GapDetected, OfferAnswered, RequestIssued
from fsar_ledger.projections.authority import LEVELS
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Registry
from fsar_ledger.projections.request import Request, Requests

from .attribution import parties, recorded_by
from .commands import Handlers
from .policy import own_policy
from .public import (
    PublicCommand,
    RobotReport,
    absent_robot,
    carried_out,
    expired_context,
    made_from,
    outdated,
    rejected,
    unknown_capability,
    unknown_word,
)

HANDLERS = Handlers()


class RequestCapability(PublicCommand):
    """Ask the executor for the capability under a new action name.

    The context is a task or a free name. Other fields: the override level asked for, the request in whose service it
    asks (`parent`), what it would dictate (`directives`), and the advertised version that it was formulated against.
    """

    requester: Robot
    executor: Robot
    capability: str
    context: str
    action_id: str
    override: OverrideLevel = "none"
    parent: str | None = None
    directives: tuple[str, ...] = ()
    version: str | None = None


class AnswerOffer(PublicCommand):
    """Answer a counter-offer: accept it, ask for this other override level, or (neither) give up."""

    requester: Robot
    action_id: str
    is_accepted: bool
    override: OverrideLevel | None = None


class ReportResult(RobotReport):
    """Report how the action ended; a partial result names the postconditions that hold."""

    executor: Robot
    action_id: str
    result: Result
    achieved: tuple[str, ...] = ()


@HANDLERS.decide(RequestCapability)
def request_capability(state: State, command: RequestCapability) -> tuple[Event, ...]:
    """Record the gap and the request, which is then on its way to the executor. Paper: eq:request, phases 1 and 3."""
    reason = _impossible(state, command)
    if reason is not None:
        return rejected(command, command.action_id, reason, command.requester)
    robot, context, action_id = command.requester, command.context, command.action_id
    parties = recorded_by(state, robot, requested_by=robot, executed_by=command.executor)
    return (
        GapDetected(Subject(context, action_id), parties, command.capability),
        made_from(
            RequestIssued,
            command,
            subject=RequestSubject(context, action_id, action_id),
            principals=parties.decided(robot),
            carried_policy=own_policy(state.policy, state.world, robot, command.capability, context),
        ),
    )


def _impossible(state: State, command: RequestCapability) -> str | None:
    """Return what is unknown, over or impossible about the request, or None.

    Whether it is admissible is for the executor to decide.
    """
    unknown = absent_robot(state.fleet, command.requester, command.executor)
    if unknown is not None:
        return unknown
    if command.requester == command.executor:
        return f"{command.requester} asks itself, expected another robot"
    unknown = unknown_capability(state.registry, command.capability) or unknown_word(
        "override level", command.override, LEVELS
    )
    unknown = unknown or expired_context(state.context, command.context)
    if unknown is not None:
        return unknown
    if not command.context or not command.action_id:
        return "the context or the action has no name, expected both"
    if ":" in command.action_id:
        return f"action name {command.action_id!r}, expected a name without a colon"
    task = command.action_id.rpartition("/")[0]
    requests, action_id = state.request, command.action_id
    if action_id in requests.open or action_id in requests.past or task in state.task or task in state.context:
        return f"the name {command.action_id} is taken, expected a new one"
    return _broken_chain(state.execution, state.request, command)


def _broken_chain(execution: Execution, requests: Requests, command: RequestCapability) -> str | None:
    """Return why the requester does not act in the service of the parent, or None. Paper: eq:nontransitive."""
    if command.parent is None:
        return None
    parent = requests.open.get(command.parent)
    if parent is None:
        return f"unknown parent {command.parent}, expected a request under way"
    if parent.is_over or parent.result is not None:
        return f"the parent {command.parent} is over, expected a request under way"
    action = execution.actions.get(command.parent)
    if action is None or not action.is_delegated or action.robot != command.requester:
        return f"{command.requester} does not execute {command.parent}, expected its executor"
    return None


@HANDLERS.decide(AnswerOffer)
def answer_offer(state: State, command: AnswerOffer) -> tuple[Event, ...]:
    """Accept the offer, ask for other terms, or withdraw. Paper: sec:model:request (negotiate)."""
    request = state.request.open.get(command.action_id)
    reason: str | None = None
    if request is None:
        reason = f"unknown request {command.action_id}, expected one with an open offer"
    elif request.offered is None or request.is_over:
        reason = "no counter-offer is open, expected one to answer"
    elif request.requester != command.requester:
        reason = f"the offer is to {request.requester}, expected its answer"
    elif command.is_accepted and command.override not in (None, request.offered):
        reason = f"{request.offered} was offered, expected no other level with a yes"
    elif command.override is not None:
        reason = unknown_word("override level", command.override, LEVELS)
    if request is None or reason is not None:
        return rejected(command, command.action_id, reason or "", command.requester)
    robot = command.requester
    return (
        OfferAnswered(
            request.request_subject,
            recorded_by(state, robot, requested_by=robot, executed_by=request.candidates[0]).decided(robot),
            request.offers,
            command.is_accepted,
            request.offered if command.is_accepted else command.override,
        ),
    )


@HANDLERS.decide(ReportResult)
def report_result(state: State, command: ReportResult) -> tuple[Event, ...]:
    """Finish the execution with this result. Paper: sec:model:request, phase 5."""
    action = state.execution.actions.get(command.action_id)
    executor, fleet = command.executor, state.fleet
    refused = outdated(fleet, executor, command.fence) if executor in fleet.robots else None
    if refused is not None:
        return rejected(command, command.action_id, refused, executor)
    if action is None:
        return rejected(
            command, command.action_id, _not_executed(state.request.open.get(command.action_id)), command.executor
        )
    reason = _not_reportable(state.registry, action, command)
    event = ExecutionFinished(
        action.subject,
        parties(state, action),
        robot=action.robot,
        result=command.result,
        achieved=command.achieved,
    )
    return carried_out(command, command.action_id, reason, command.executor, event)


def _not_executed(request: Request | None) -> str:
    if request is None:
        return "unknown request, expected one that is being executed"
    if request.is_over or request.result is not None:
        return "the request is over, expected one that is being executed"
    return "the request has not been admitted, expected one that is being executed"


def _not_reportable(registry: Registry, action: Action, command: ReportResult) -> str | None:
    """Return why the executor cannot report this result now, or None.

    A failure is first handled by its own recovery.
    """
    unreadable = unknown_word("result", command.result, get_args(Result))
    if unreadable is not None:
        return unreadable
    if action.robot != command.executor:
        return f"{action.robot} executes it, expected the report of that robot"
    if action.stage not in ("running", "paused"):
        return f"it is {action.stage}, expected an action that is running or paused"
    if (command.result == "partial") != bool(command.achieved):
        return (
            f"a {command.result} result with {len(command.achieved)} postconditions achieved, "
            "expected some for a partial one and none else"
        )
    module = registry.modules.get(action.robot, {}).get(action.capability)
    promised = () if module is None else module.contract.postconditions
    unknown = [name for name in command.achieved if promised and name not in promised]
    return (
        f"{unknown[0]} is no postcondition of {action.capability}, expected {', '.join(promised)}" if unknown else None
    )
