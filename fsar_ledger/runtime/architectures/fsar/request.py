"""FSAR: a delegated step is a governed request between two robots. Paper: sec:model:request, eq:admissible."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import (
    COORDINATION,
    FLEET_SUPERVISOR,
    Parties,
    RequestSubject,
    Robot,
)
from fsar_ledger.events.execution import ApproachStarted, ExecutionPreempted
from fsar_ledger.events.request import (
    RequestAccepted,
    RequestAdmitted,
    RequestClosed,
    RequestCountered,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestRelayed,
)
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.execution import Execution
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import is_asked
from fsar_ledger.projections.task import Tasks
from fsar_ledger.projections.world import World, stricter
from fsar_ledger.runtime.handlers.actors import asked, body, nobody, relay, requester
from fsar_ledger.runtime.handlers.admissibility import Evaluation, evaluate, is_revoked, preemptible
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.commands import CloseRequest, Command, Handlers, TakeTurn
from fsar_ledger.runtime.handlers.execution import holds_robot, queued
from fsar_ledger.runtime.handlers.policy import conflict, own_policy
from fsar_ledger.runtime.handlers.supervision import is_due_for_review
from fsar_ledger.runtime.handlers.trust import trusts

from .availability import ReportBack, found_silent, report_back
from .contention import put_in_order
from .discovery import unanswered

HANDLERS = Handlers()


class IssueRequest(Command):
    """Deliver the answer to the requester."""

    action_id: str


class RelayRequest(Command):
    """Deliver the request to the doubly trusted peer."""

    action_id: str


class EvaluateRequest(Command):
    """Deliver the request to the executor."""

    action_id: str


class GoOnWithout(Command):
    """End the time in which the request should have been delivered.

    To the robot it was sent to, or (`is_relayed`) to the one that the relay has passed it on to.
    """

    action_id: str
    is_relayed: bool = False


class AdmitReviewed(Command):
    """Take a supervisor's decision on what policy or supervision density wanted reviewed."""

    action_id: str
    approves: bool = True


@HANDLERS.decide(IssueRequest, requester)
def issue_request(state: State, command: IssueRequest) -> tuple[Event, ...]:
    """Send the request with the requester's own policy; back off without a candidate."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    if not request.candidates:
        return (unanswered(state.fleet, state.world, request),)
    robot, executor = request.requester, request.candidates[0]
    parties = recorded_by(state.fleet, state.world, robot, requested_by=robot, executed_by=executor)
    return (
        RequestIssued(
            subject=request.request_subject,
            principals=parties.decided(robot),
            capability=request.capability,
            carried_policy=own_policy(state.policy, state.world, robot, request.capability, request.task_id),
            relay=request.relay,
        ),
    )


@HANDLERS.decide(RelayRequest, relay)
def relay_request(state: State, command: RelayRequest) -> tuple[Event, ...]:
    """Pass the request on with the relay's policy added, or let the relay deny it. Paper: eq:nontransitive."""
    request = state.request.open.get(command.action_id)
    if request is None or request.relay is None:
        return ()
    if request.silent:  # too late, as of an executor
        return report_back(state, ReportBack(request.silent[0]))
    relay, about = request.relay, (request.capability, request.task_id)
    parties = recorded_by(
        state.fleet, state.world, relay, requested_by=request.requester, executed_by=request.candidates[0]
    )
    subject, principals = request.request_subject, parties.decided(request.requester, relay)
    if not trusts(state, relay, request.requester, *about):
        return (RequestDenied(subject, principals, "trust"),)
    if is_revoked(state.authority, request, relay):
        return (RequestDenied(subject, principals, "authority"),)
    carried = stricter(request.carried, own_policy(state.policy, state.world, relay, *about))
    return (RequestRelayed(subject, principals, carried),)


@HANDLERS.decide(EvaluateRequest, asked)
def evaluate_request(state: State, command: EvaluateRequest) -> tuple[Event, ...]:
    """Admit, counter or deny the request at the executor, or ask H_F for review. Paper: eq:admissible, phase 4."""
    request = state.request.open.get(command.action_id)
    if request is not None and request.silent:  # too late; it was found silent, and its word says otherwise
        return report_back(state, ReportBack(request.silent[0]))
    if (
        request is None
        or not _is_open(state.execution, state.task, request)
        or is_asked(state.supervision, request.action_id, "review")
    ):
        return ()
    return _judged(state, request, evaluate(state, request, request.candidates[0]), command.now_us)


@HANDLERS.decide(AdmitReviewed, asked)
def admit_reviewed(state: State, command: AdmitReviewed) -> tuple[Event, ...]:
    """Admit the approved request if all but policy still holds, or deny one that was not approved."""
    request = state.request.open.get(command.action_id)
    if request is None or not _is_open(state.execution, state.task, request):
        return ()
    executor = request.candidates[0]
    if not command.approves:
        by_executor = _parties(state.fleet, state.world, request, executor).decided(executor)
        return (RequestDenied(request.request_subject, by_executor, "review"),)
    found = evaluate(state, request, executor, is_reviewed=True)
    return _judged(state, request, found, command.now_us, is_reviewed=True)


@HANDLERS.decide(GoOnWithout, requester)
def go_on_without(state: State, command: GoOnWithout) -> tuple[Event, ...]:
    """Record that the request was not delivered in time, and tell the registry who was silent.

    The requester tries again later. Reading: R44.
    """
    request = state.request.open.get(command.action_id)
    if request is None or request.is_relayed != command.is_relayed:
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
        unanswered(state.fleet, state.world, request, silent),
        *found_silent(state.fleet, state.registry, (silent,)),
    )


def _is_open(execution: Execution, tasks: Tasks, request: Request) -> bool:
    """Tell whether the request waits for the executor."""
    if not request.is_adhoc and request.task_id not in tasks:  # its task was given up
        return False
    has_word = request.is_over or request.is_accepted or request.is_unanswered or request.offered is not None
    return not has_word and request.action_id not in execution.actions


def _judged(
    state: State, request: Request, found: Evaluation, now_us: int, is_reviewed: bool = False
) -> tuple[Event, ...]:
    executor = request.candidates[0]
    subject = request.request_subject
    principals = _parties(state.fleet, state.world, request, executor).decided(executor)
    if found.verdict == "reject":
        clash = (
            conflict(state, request.task_id, request.action_id, request.requester, executor, request.capability)
            if found.conjunct == "policy"
            else ()
        )
        return (*clash, RequestDenied(subject, principals, found.conjunct or ""))
    if found.verdict == "negotiate":
        if request.offers >= state.fleet.structure.negotiation_rounds:
            return (RequestDenied(subject, principals, "negotiation"),)
        return (RequestCountered(subject, principals, round=request.offers + 1, override=found.override),)
    if found.verdict == "review" or (not is_reviewed and is_due_for_review(state.supervision, executor)):
        return (SupervisorCalled(subject=request.subject, supervisor=FLEET_SUPERVISOR, purpose="review"),)
    return put_in_order(state, request, executor, principals) or _admitted(state, request, found, now_us)


def _parties(fleet: Fleet, world: World, request: Request, executor: Robot) -> Parties:
    """Return whom the executor's records of the request name."""
    return recorded_by(fleet, world, executor, requested_by=request.requester, executed_by=executor)


def _admitted(state: State, request: Request, found: Evaluation, now_us: int) -> tuple[Event, ...]:
    """Admit the request with its authority, and let it wait for the robot or take it. Paper: eq:auth, eq:override."""
    executor = request.candidates[0]
    parties = _parties(state.fleet, state.world, request, executor)
    principals = parties.decided(executor)
    admitted = RequestAdmitted(
        subject=request.request_subject,
        principals=principals,
        outcome="allow",
        trust=found.trust,
        may_request=found.may_request,
        may_execute=found.may_execute,
        override=found.override,
        is_audited=found.is_audited,
    )
    waiting = queued(request, parties, executor, found.override)
    if found.verdict == "defer":
        return (admitted, RequestDeferred(request.request_subject, principals), waiting)
    interrupted = preemptible(state.execution, executor, found.override)
    if interrupted is None:
        return (admitted, waiting)
    remaining_us = {"running": max(0, interrupted.ends_us - now_us), "paused": interrupted.remaining_us}.get(
        interrupted.stage
    )
    return (admitted, ExecutionPreempted(interrupted.subject, executor, request.action_id, remaining_us), waiting)


@HANDLERS.decide(TakeTurn, body)
def take_turn(state: State, command: TakeTurn) -> tuple[Event, ...]:
    """Accept the request, claim execution and override, and approach.

    A request that was preempted comes back as accepted. Paper: eq:auth.
    """
    action = state.execution.actions.get(command.action_id)
    if action is None or action.stage not in ("queued", "preempted") or not holds_robot(state.execution, action):
        return ()
    robot = action.robot
    approach = ApproachStarted(action.subject, robot)
    if any(
        claim.claimant == robot and claim.dimension == "execution"
        for claim in state.authority.claims.get(action.action_id, ())
    ):
        return (approach,)
    parties = recorded_by(state.fleet, state.world, robot, requested_by=action.requested_by, executed_by=robot)
    return (
        RequestAccepted(RequestSubject(action.task_id, action.action_id, action.action_id), parties.decided(robot)),
        AuthorityClaimed(action.subject, "execution", robot, "acceptance"),
        AuthorityClaimed(action.subject, "override", robot, "acceptance"),
        approach,
    )


@HANDLERS.decide(CloseRequest, nobody)
def close_request(state: State, command: CloseRequest) -> tuple[Event, ...]:
    """Close the request at the coordination engine. Paper: sec:architecture:fleet."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    parties = recorded_by(
        state.fleet, state.world, request.requester, requested_by=request.requester, executed_by=request.target
    )
    return (RequestClosed(request.request_subject, parties.decided(COORDINATION), request.result or "success"),)
