"""FSAR: a delegated step is a governed request between two robots, from its delivery to the executor on.

Paper: sec:model:request (phases 4 and 5), eq:admissible.

H_F orders two requests for one robot when one of them is time-critical (sec:prototype:workflows, Workflow 3). The
policy resolver's outcome is then `review`: the request that was evaluated first calls H_F and the other joins the call.
Both are evaluated again in the order that H_F has given: the second waits until the first is admitted or refused. A
request that has not reached the executor by then delays no other. Without a time-critical task, requests wait in order
of arrival.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATION, FLEET_SUPERVISOR, Parties, Principals, Robot
from fsar_ledger.events.execution import ExecutionFinished, ExecutionPreempted
from fsar_ledger.events.request import (
    OfferAnswered,
    PeerSought,
    RequestAdmitted,
    RequestClosed,
    RequestCountered,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestRelayed,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.projections.contention import Contention, Order, held_up, in_order, order_of
from fsar_ledger.projections.execution import Execution, left_us
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import is_asked
from fsar_ledger.projections.task import Tasks
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.handlers.admissibility import Evaluation, evaluate, is_revoked, preemptible, was_reviewed
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    CloseRequest,
    CompleteStep,
    Handlers,
    Scheduled,
    asked_robot,
    at_once,
    begin_again,
    message,
    nobody,
    open_request,
    relay,
    requester,
)
from fsar_ledger.runtime.handlers.execution import queued
from fsar_ledger.runtime.handlers.policy import conflict, own_policy
from fsar_ledger.runtime.handlers.supervision import is_due_for_review
from fsar_ledger.runtime.handlers.task import is_critical
from fsar_ledger.runtime.handlers.trust import trusts
from fsar_ledger.runtime.ports import Ask

from .availability import ReportBack, found_silent, report_back
from .discovery import unanswered

HANDLERS = Handlers()


class RelayRequest(ActionCommand):
    """Deliver the request to the doubly trusted peer."""


class EvaluateRequest(ActionCommand):
    """Deliver the request to the executor."""


def judgement(action_id: str, after_us: int, waits: tuple[Ask, ...] = ()) -> Scheduled:
    """Ask the executor for its own judgement of the request; a simulated robot judges by the model's policy."""
    return Scheduled(EvaluateRequest(action_id), after_us, waits, Ask("decision", "admission", action_id))


class GoOnWithout(ActionCommand):
    """End the time in which the request should have been delivered.

    `is_relayed`: to the robot that the relay passed it on to, else to the one it was sent to.
    """

    is_relayed: bool = False


class AdmitReviewed(ActionCommand):
    """Act on a supervisor's decision about a request under review by policy or supervision density."""

    approves: bool = True


@HANDLERS.decide_on(open_request, RelayRequest, relay)
def relay_request(state: State, _command: RelayRequest, request: Request) -> tuple[Event, ...]:
    """Pass the request on with the relay's policy added, or let the relay deny it. Paper: eq:nontransitive."""
    if request.relay is None:
        return ()
    if request.silent:  # too late, as with a silent executor
        return report_back(state, ReportBack(request.silent[0]))
    if request.is_over:  # one of its robots has left the fleet meanwhile
        return ()
    relay, about = request.relay, (request.capability, request.task_id)
    parties = recorded_by(state, relay, requested_by=request.requester, executed_by=request.candidates[0])
    subject, principals = request.request_subject, parties.decided(request.requester, relay)
    if not trusts(state, relay, request.requester, *about):
        return (RequestDenied(subject, principals, "trust"),)
    if is_revoked(state.authority, request, relay):
        return (RequestDenied(subject, principals, "authority"),)
    carried = stricter(request.carried, own_policy(state.policy, state.world, relay, *about))
    return (RequestRelayed(subject, principals, carried),)


@HANDLERS.decide(EvaluateRequest, asked_robot)
def evaluate_request(state: State, command: EvaluateRequest) -> tuple[Event, ...]:
    """Admit, counter or deny the request at the executor, or ask H_F for review. Paper: eq:admissible, phase 4."""
    request = state.request.open.get(command.action_id)
    if request is not None and request.silent:  # too late: the robot was found silent, and answers after all
        return report_back(state, ReportBack(request.silent[0]))
    if (
        request is None
        or not _is_open(state.execution, state.task, request)
        or is_asked(state.supervision, request.action_id, "review")
    ):
        return ()
    executor = request.candidates[0]
    is_reviewed = was_reviewed(state, request, executor)  # before H_F has put it in order
    return _judged(state, request, evaluate(state, request, executor, is_reviewed), command.now_us, is_reviewed)


@HANDLERS.decide_on(open_request, AdmitReviewed, asked_robot)
def admit_reviewed(state: State, command: AdmitReviewed, request: Request) -> tuple[Event, ...]:
    """Admit the approved request if all but policy still holds, or deny one that was not approved."""
    if not _is_open(state.execution, state.task, request):
        return ()
    executor = request.candidates[0]
    if not command.approves:
        by_executor = _parties(state, request, executor).decided(executor)
        return (RequestDenied(request.request_subject, by_executor, "review"),)
    evaluation = evaluate(state, request, executor, is_reviewed=True)
    return _judged(state, request, evaluation, command.now_us, is_reviewed=True)


@HANDLERS.decide_on(open_request, GoOnWithout, requester)
def go_on_without(state: State, command: GoOnWithout, request: Request) -> tuple[Event, ...]:
    """Record that the request was not delivered in time, and report the silent robot to the registry.

    The requester tries again later. Reading: R44.
    """
    if request.is_relayed != command.is_relayed:
        return ()
    if (
        not request.candidates
        or request.is_heard
        or request.is_received
        or request.offers
        or not _is_open(state.execution, state.task, request)
    ):
        return ()
    executor = request.candidates[0]
    silent = executor if request.relay is None or request.is_relayed else request.relay
    return (
        unanswered(state, request, silent),
        *found_silent(state.fleet, state.registry, (silent,)),
    )


def _is_open(execution: Execution, tasks: Tasks, request: Request) -> bool:
    """Return whether the request waits for the executor."""
    if not request.is_adhoc and request.task_id not in tasks:  # its task was given up
        return False
    is_settled = request.is_over or request.is_accepted or request.is_unanswered or request.offered is not None
    return not is_settled and request.action_id not in execution.actions


def _judged(
    state: State, request: Request, evaluation: Evaluation, now_us: int, is_reviewed: bool = False
) -> tuple[Event, ...]:
    executor = request.candidates[0]
    subject = request.request_subject
    principals = _parties(state, request, executor).decided(executor)
    if evaluation.verdict == "reject":
        clash = (
            conflict(state, request.task_id, request.action_id, request.requester, executor, request.capability)
            if evaluation.conjunct == "policy"
            else ()
        )
        return (*clash, RequestDenied(subject, principals, evaluation.conjunct or ""))
    if evaluation.verdict == "negotiate":
        if request.offers >= state.fleet.structure.negotiation_rounds:
            return (RequestDenied(subject, principals, "negotiation"),)
        return (RequestCountered(subject, principals, round=request.offers + 1, override=evaluation.override),)
    if evaluation.verdict == "review" or (not is_reviewed and is_due_for_review(state.supervision, executor)):
        return (SupervisorCalled(subject=request.subject, supervisor=FLEET_SUPERVISOR, purpose="review"),)
    return _put_in_order(state, request, executor, principals) or _admitted(state, request, evaluation, now_us)


def _put_in_order(state: State, request: Request, executor: Robot, principals: Principals) -> tuple[Event, ...]:
    """Call H_F to order this admissible request and its rival, or let it wait; do nothing without a rival.

    It waits for H_F's answer, or for the rival that H_F lets go first.

    Reading: a request competes from the detection of its gap until the executor has admitted it.
    """
    rivals = _rivals(state, request, executor)
    if not rivals:
        return ()
    orders = [
        (order, rival)
        for rival in rivals
        if (order := order_of(state.contention, request.action_id, rival.action_id)) is not None
    ]
    if any(not order.is_answered or _goes_first(state.contention, order, rival) for order, rival in orders):
        return (RequestDeferred(request.request_subject, principals),)
    if orders:
        return ()
    return (
        SupervisorCalled(
            subject=request.subject,
            supervisor=FLEET_SUPERVISOR,
            purpose="ordering",
            robot=executor,
            competing=rivals[0].action_id,
        ),
    )


def _goes_first(contention: Contention, order: Order, rival: Request) -> bool:
    """Return whether the rival that H_F lets go first is itself still waiting for the executor."""
    return order.preferred == rival.action_id and rival.action_id in contention.arrived and rival.offered is None


def _rivals(state: State, request: Request, executor: Robot) -> list[Request]:
    """Return the unadmitted requests of other tasks for the same robot, where either is time-critical."""
    if not state.contention.critical:
        return []
    rivals = []
    for other in state.request.open.values():
        is_settled = (
            other.is_accepted or other.is_over or other.is_unanswered or other.action_id in state.execution.actions
        )
        is_same_robot = other.candidates[0] == executor if other.candidates else other.capability == request.capability
        is_urgent = is_critical(state.task, request.task_id) or is_critical(state.task, other.task_id)
        if (
            other.task_id != request.task_id
            and other.task_id in state.task
            and other.is_delegated
            and not is_settled
            and is_same_robot
            and is_urgent
        ):
            rivals.append(other)
    return rivals


def _parties(state: State, request: Request, executor: Robot) -> Parties:
    """Return the parties of the executor's records of the request."""
    return recorded_by(state, executor, requested_by=request.requester, executed_by=executor)


def _admitted(state: State, request: Request, evaluation: Evaluation, now_us: int) -> tuple[Event, ...]:
    """Admit the request with its authority, and let it wait for the robot or take it. Paper: eq:auth, eq:override."""
    executor = request.candidates[0]
    parties = _parties(state, request, executor)
    principals = parties.decided(executor)
    admitted = RequestAdmitted(
        subject=request.request_subject,
        principals=principals,
        outcome="allow",
        trust=evaluation.trust,
        may_request=evaluation.may_request,
        may_execute=evaluation.may_execute,
        override=evaluation.override,
        is_audited=evaluation.is_audited,
    )
    waiting = queued(request, parties, executor, evaluation.override)
    if evaluation.verdict == "defer":
        return (admitted, RequestDeferred(request.request_subject, principals), waiting)
    interrupted = preemptible(state.execution, executor, evaluation.override)
    if interrupted is None:
        return (admitted, waiting)
    remaining_us = {"running": left_us(interrupted, now_us), "paused": interrupted.remaining_us}.get(interrupted.stage)
    return (admitted, ExecutionPreempted(interrupted.subject, executor, request.action_id, remaining_us), waiting)


@HANDLERS.decide_on(open_request, CloseRequest, nobody)
def close_request(state: State, _command: CloseRequest, request: Request) -> tuple[Event, ...]:
    """Close the request at the coordination engine. Paper: sec:architecture:fleet."""
    parties = recorded_by(state, request.requester, requested_by=request.requester, executed_by=request.target)
    return (RequestClosed(request.request_subject, parties.decided(COORDINATION), request.result or "success"),)


def _is_step(tasks: Tasks, request: Request | None) -> bool:
    """Return whether the request is a step of an open task, not an outsider's or a robot's own."""
    return request is not None and not request.is_adhoc and request.task_id in tasks


@HANDLERS.react(RequestIssued)
def _on_request(state: State, event: RequestIssued, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    request = state.request.open.get(event.subject.action_id)
    if request is None or not (request.is_adhoc or _is_step(state.task, request)):
        return ()
    waits = (message(request.requester, event.subject.action_id, 2),)
    delivery = (
        Scheduled(RelayRequest(event.subject.action_id), 0, waits)
        if event.relay
        else judgement(event.subject.action_id, 0, waits)
    )
    return (
        delivery,
        Scheduled(GoOnWithout(event.subject.action_id), state.fleet.answer_us, (at_once(request.requester),)),
    )


@HANDLERS.react(RequestRelayed)
def _on_relay(state: State, event: RequestRelayed, _now_us: int) -> tuple[Scheduled, ...]:
    delivery = judgement(
        event.subject.action_id, 0, (message(event.principals.decided_by, event.subject.action_id, 3),)
    )
    timeout = GoOnWithout(event.subject.action_id, is_relayed=True)
    return (delivery, Scheduled(timeout, state.fleet.answer_us, (at_once(event.principals.requested_by),)))


@HANDLERS.react(RequestDenied)
def _on_denial(state: State, event: RequestDenied, now_us: int) -> tuple[Scheduled, ...]:
    return (*_again(state, event.subject.action_id), *_let_pass(state, event, now_us))


@HANDLERS.react(RequestAdmitted, RequestCountered)
def _let_pass(
    state: State, event: RequestAdmitted | RequestCountered | RequestDenied | RequestClosed, _now_us: int
) -> tuple[Scheduled, ...]:
    """Evaluate again the requests that waited for one that H_F let go first."""
    if not state.contention.orders:
        return ()
    return tuple(
        judgement(name, delay_us)
        for delay_us, name in enumerate(held_up(state.contention, event.subject.action_id), start=1)
    )


@HANDLERS.react(OfferAnswered)
def _on_offer(state: State, event: OfferAnswered, _now_us: int) -> tuple[Scheduled, ...]:
    """Evaluate the changed request again, or retry a step whose requester withdrew it."""
    assert event.subject.action_id is not None
    if event.override is None:
        return _again(state, event.subject.action_id)
    waits = (message(event.principals.requested_by, event.subject.action_id, f"offer{event.round}"),)
    return (judgement(event.subject.action_id, 0, waits),)


def _again(state: State, action_id: str | None) -> tuple[Scheduled, ...]:
    request = state.request.open.get(action_id or "")
    if request is None or not _is_step(state.task, request):
        return ()
    return (begin_again(state.fleet, request.task_id, request.action_id),)


@HANDLERS.react(RequestUnanswered, PeerSought)
def _on_unanswered(state: State, event: RequestUnanswered | PeerSought, _now_us: int) -> tuple[Scheduled, ...]:
    return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)


@HANDLERS.react(SupervisorResponded)
def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    if event.purpose == "ordering":
        waiting = in_order(state.contention, event.subject.action_id, event.preferred)
        return tuple(judgement(name, delay_us) for delay_us, name in enumerate(waiting, start=1))
    if event.purpose != "review":
        return ()
    return (
        Scheduled(AdmitReviewed(event.subject.action_id, event.approves), 1, (at_once(event.principals.decided_by),)),
    )


@HANDLERS.react(ExecutionFinished)
def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(event.subject.action_id)
    if request is None or not (request.is_adhoc or _is_step(state.task, request)):
        return ()
    if event.robot != request.requester:
        return (
            Scheduled(CloseRequest(event.subject.action_id), 0, (message(event.robot, event.subject.action_id, 4),)),
        )
    if event.result == "success":
        return (Scheduled(CompleteStep(event.subject.action_id)),)
    return _again(state, event.subject.action_id)


@HANDLERS.react(RequestClosed)
def _on_close(state: State, event: RequestClosed, now_us: int) -> tuple[Scheduled, ...]:
    """Complete the step, or retry later a step that did not succeed."""
    judgements = _let_pass(state, event, now_us) if event.cause is not None else ()
    if not _is_step(state.task, state.request.open.get(event.subject.action_id)):
        return judgements
    done = Scheduled(CompleteStep(event.subject.action_id), 1, (at_once(event.principals.decided_by),))
    return (done,) if event.result == "success" else (*_again(state, event.subject.action_id), *judgements)
