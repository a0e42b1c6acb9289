"""Open requests, one per action, under every architecture's negotiation. Paper: eq:request."""

from collections.abc import Mapping
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import (
    ActionId,
    OverrideLevel,
    PolicyOutcome,
    RequestId,
    RequestSubject,
    Result,
    Robot,
    Subject,
    TaskId,
    recorded_robot,
)
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    CommandIssued,
    ContractQuestioned,
    ContractVoided,
    MessageUndelivered,
    OfferAnswered,
    RequestAccepted,
    RequestClosed,
    RequestCountered,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestRelayed,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned
from fsar_ledger.events.world import OutsiderRequestInjected

from . import put, without

HANDLES = (
    StepBegan
    | StepCompleted
    | TaskAbandoned
    | OutsiderRequestInjected
    | RegistryQueried
    | RequestIssued
    | RequestRelayed
    | CommandIssued
    | BidSubmitted
    | BidReceived
    | SupervisorCalled
    | AwardMade
    | RequestAccepted
    | ContractQuestioned
    | ContractVoided
    | MessageUndelivered
    | RequestDenied
    | RequestCountered
    | RequestDeferred
    | RequestUnanswered
    | OfferAnswered
    | ExecutionQueued
    | ExecutionFinished
    | RequestClosed
)


MOST = 1 << 11
"""Once it has this many requests, a live run forgets those that are over."""


class Request(msgspec.Struct, frozen=True, gc=False):
    """The request for one action. `target` is the robot asked; `round` counts negotiations from 0.

    `is_adhoc`: it was issued on its own and is no step of a task, whatever its context; it is kept when it is over, so
    that its name is not used again, in a live run for a while (`fold.forget`).
    `offered` is the override level of the counter-offer that awaits an answer, `offers` the number of counter-offers.
    `result` is known once the execution is over. `is_over`: it was refused, closed or given up, and nothing more is
    decided about it.
    `is_relayed`: the relay has passed it on. `is_heard`: the robot asked has deferred it or called a supervisor.
    `is_received`: a robot has it, in its queue or while H_F orders two. `is_unanswered`: the time for an answer
    has run out; `silent`: the robots that did not answer in time.
    `bids`: the bids received, in that order; `underway`: those sent but not received yet; `ahead`:
    robot -> the number of actions that come first there, by its bid; `undelivered`: the robots that a message of this
    round cannot reach; `failed`: the robots whose contracts were void, in order.
    """

    task_id: str
    action_id: str
    requester: Robot
    capability: str
    step: int
    attempt: int
    is_delegated: bool
    candidates: tuple[Robot, ...] = ()
    relay: Robot | None = None
    carried: PolicyOutcome = "allow"
    target: Robot | None = None
    seen_busy: bool = False
    bids: Mapping[Robot, PolicyOutcome] = {}
    underway: Mapping[Robot, PolicyOutcome] = {}
    ahead: Mapping[Robot, int] = {}
    undelivered: tuple[Robot, ...] = ()
    failed: tuple[Robot, ...] = ()
    is_accepted: bool = False
    is_questioned: bool = False
    round: int = 0
    is_adhoc: bool = False
    override: OverrideLevel = "none"
    parent: str | None = None
    directives: tuple[str, ...] = ()
    version: str | None = None
    offers: int = 0
    offered: OverrideLevel | None = None
    result: Result | None = None
    is_over: bool = False
    is_relayed: bool = False
    is_heard: bool = False
    is_received: bool = False
    is_unanswered: bool = False
    silent: tuple[Robot, ...] = ()

    @property
    def subject(self) -> Subject[TaskId, ActionId]:
        """Return the subject of the action's events."""
        return Subject(self.task_id, self.action_id)

    @property
    def request_subject(self) -> RequestSubject[TaskId, ActionId, RequestId]:
        """Return the subject of the request's events; the request has the name of its action."""
        return RequestSubject(self.task_id, self.action_id, self.action_id)


class Requests(msgspec.Struct, frozen=True, gc=False):
    """The requests: `open`: action -> its request; `of_task`: task -> the action of its step's request.

    `past`: the names of forgotten requests of no step and, ended by a slash, the names that no task may have because of
    them. When there are `most` in `open`, those that are over are forgotten.
    """

    open: Mapping[str, Request] = {}
    of_task: Mapping[str, str] = {}
    past: Mapping[str, bool] = {}
    most: int = MOST


INITIAL = Requests()


def evolve(state: Requests, event: HANDLES) -> Requests:
    """Return the requests after the event."""
    match event:
        case StepBegan():
            return _begin_request(state, event)
        case ExecutionFinished() | RequestClosed() | RequestDenied():
            return _end_request(state, event)
        case StepCompleted():
            return removed(state, event.subject.action_id)
        case TaskAbandoned():
            return _abandoned(state, event)
        case OutsiderRequestInjected():
            return _injected(state, event)
        case RegistryQueried():
            request = state.open.get(event.subject.action_id or "")
            if request is None or request.capability != event.capability:  # a query for the action's recovery
                return state
            return _changed(state, event.subject.action_id, candidates=event.candidates, relay=event.relay)
        case RequestIssued():
            return _issued(state, event)
        case RequestRelayed():
            return _changed(state, event.subject.action_id, carried=event.carried_policy, is_relayed=True)
        case CommandIssued():
            return _changed(
                state, event.subject.action_id, target=event.robot, seen_busy=event.seen_busy, is_unanswered=False
            )
        case BidSubmitted():
            return _bid(state, event)
        case BidReceived():
            return _bid_received(state, event)
        case AwardMade():
            return _changed(state, state.of_task.get(event.task_id), target=event.robot, is_questioned=False)
        case SupervisorCalled():
            return _called(state, event)
        case ExecutionQueued():
            return _changed(state, event.subject.action_id, is_received=True)
        case RequestDeferred():
            return _changed(state, event.subject.action_id, is_heard=True)
        case RequestAccepted():
            return _changed(state, event.subject.action_id, target=event.principals.executed_by, is_accepted=True)
        case ContractQuestioned():
            return _changed(state, event.subject.action_id, is_questioned=True)
        case ContractVoided():
            return _voided(state, event)
        case MessageUndelivered():
            return _undelivered(state, event)
        case RequestUnanswered():
            return _unanswered(state, event)
        case RequestCountered():
            return _changed(state, event.subject.action_id, offers=event.round, offered=event.override)
        case OfferAnswered():
            return _apply_offer_answer(state, event)
        case _:
            assert_never(event)


def _begin_request(state: Requests, event: StepBegan) -> Requests:
    """Begin the request for the step, which replaces the task's earlier one."""
    others = removed(state, state.of_task.get(event.subject.task_id))
    begun = Request(
        event.subject.task_id,
        event.subject.action_id,
        event.robot,
        event.capability,
        event.step,
        event.attempt,
        event.target_role is not None,
    )
    return _of_step(others, begun)


def _abandoned(state: Requests, event: TaskAbandoned) -> Requests:
    """Keep the requests that a robot has, which continue or are withdrawn there; the rest get no answer."""
    request = state.open.get(state.of_task.get(event.task_id, ""))
    return state if request is None or request.is_received else removed(state, request.action_id)


def _injected(state: Requests, event: OutsiderRequestInjected) -> Requests:
    """Begin an outsider's request, which is named after its task."""
    injected = Request(
        event.task_id,
        event.task_id,
        event.robot,
        event.capability,
        0,
        1,
        True,
        (event.peer,),
        target=event.peer,
    )
    return _of_step(state, injected)


def _bid_received(state: Requests, event: BidReceived) -> Requests:
    """Record the bid as read, replacing an earlier one: a robot that answers late was asked again."""
    request = state.open.get(event.subject.action_id)
    if request is None:
        return state
    bids = put(without(request.bids, event.robot), event.robot, event.outcome)
    ahead = request.ahead if event.ahead is None else put(request.ahead, event.robot, event.ahead)
    return _changed(state, request.action_id, bids=bids, underway=without(request.underway, event.robot), ahead=ahead)


def _undelivered(state: Requests, event: MessageUndelivered) -> Requests:
    request = state.open.get(event.subject.action_id)
    if request is None:
        return state
    return _changed(state, request.action_id, undelivered=(*request.undelivered, event.robot))


def _voided(state: Requests, event: ContractVoided) -> Requests:
    """Start another round without bids, target or contract."""
    request = state.open.get(event.subject.action_id)
    if request is None:
        return state
    return _changed(
        state,
        event.subject.action_id,
        bids={},
        underway={},
        ahead={},
        undelivered=(),
        failed=(*request.failed, event.robot),
        target=None,
        is_accepted=False,
        is_questioned=False,
        is_received=False,
        round=request.round + 1,
    )


def _issued(state: Requests, event: RequestIssued) -> Requests:
    """Record the request as sent; one that belongs to no step begins here. Paper: eq:request."""
    task_id = event.subject.task_id
    action_id = event.subject.action_id
    robot = event.principals.requested_by
    executor = event.principals.executed_by
    carried = event.carried_policy or "allow"
    if action_id in state.open or task_id is None or action_id is None or robot is None or executor is None:
        return _changed(state, action_id, carried=carried, relay=event.relay, override=event.override)
    begun = Request(
        task_id, action_id, recorded_robot(robot), event.capability, 1, 1, True, (executor,), event.relay, carried
    )
    terms = {
        "override": event.override,
        "parent": event.parent,
        "directives": event.directives,
        "version": event.version,
    }
    adhoc = msgspec.structs.replace(begun, is_adhoc=True, **terms)
    return Requests(put(state.open, action_id, adhoc), state.of_task, state.past, state.most)


def _end_request(state: Requests, event: ExecutionFinished | RequestClosed | RequestDenied) -> Requests:
    """End the request or set its result; the success of a step is only known when the step ends.

    An outsider's request, which is no step, has its task's name, by which a coordinator denies it, and ends when it
    has been executed.
    """
    request = state.open.get(event.subject.action_id or event.subject.task_id or "")
    if request is None:
        return state
    if isinstance(event, ExecutionFinished) and (request.step > 0 or request.is_adhoc):
        if not (request.is_adhoc or event.result != "success"):
            return state
        return _changed(state, request.action_id, result=event.result)
    return _changed(state, request.action_id, is_over=True)


def _called(state: Requests, event: SupervisorCalled) -> Requests:
    """Submit the request to a supervisor; the caller has received both of two requests to be ordered."""
    request = state.open.get(event.subject.action_id)
    if request is None:
        return state
    is_received = request.is_received or event.purpose == "ordering"
    return _changed(
        state, event.subject.action_id, is_heard=True, is_received=is_received, target=event.robot or request.target
    )


def _bid(state: Requests, event: BidSubmitted) -> Requests:
    """Record a bid; it names only the task, which has one step at a time."""
    request = state.open.get(state.of_task.get(event.task_id, ""))
    if request is None or event.robot in request.bids:
        return state
    return _changed(state, request.action_id, underway=put(request.underway, event.robot, event.outcome))


def _unanswered(state: Requests, event: RequestUnanswered) -> Requests:
    """End the request to the robot that did not answer.

    If the event names none, no robot answered or there was none to ask.
    """
    request = state.open.get(event.subject.action_id or "")
    if request is None:
        return state
    executor = event.principals.executed_by
    silent = request.silent if executor is None else (*request.silent, executor)
    return _changed(state, event.subject.action_id, silent=silent, target=None, is_accepted=False, is_unanswered=True)


def _apply_offer_answer(state: Requests, event: OfferAnswered) -> Requests:
    """Record the requester's answer: the executor evaluates again, or the request is over."""
    request = state.open.get(event.subject.action_id or "")
    if request is None:
        return state
    override = request.offered if event.is_accepted else event.override
    if override is None:
        return _changed(state, event.subject.action_id, offered=None, is_over=True)
    return _changed(state, event.subject.action_id, offered=None, override=override)


def _changed(state: Requests, action_id: str | None, **changes: object) -> Requests:
    request = state.open.get(action_id or "")
    if request is None:
        return state
    changed = put(state.open, request.action_id, msgspec.structs.replace(request, **changes))
    return Requests(changed, state.of_task, state.past, state.most)


def _of_step(state: Requests, request: Request) -> Requests:
    """Add the request of a task's step."""
    of_task = put(state.of_task, request.task_id, request.action_id)
    return Requests(put(state.open, request.action_id, request), of_task, state.past, state.most)


def removed(state: Requests, action_id: str | None) -> Requests:
    """Remove the action's request, if it has one."""
    request = state.open.get(action_id or "")
    if request is None:
        return state
    is_of_step = state.of_task.get(request.task_id) == request.action_id
    of_task = without(state.of_task, request.task_id) if is_of_step else state.of_task
    return Requests(without(state.open, request.action_id), of_task, state.past, state.most)
