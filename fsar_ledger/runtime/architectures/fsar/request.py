"""FSAR: a delegated step is a governed request between two robots. Paper: sec:model:request, eq:admissible."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import COORDINATION, FLEET_SUPERVISOR
from fsar_ledger.events.execution import ApproachStarted, ExecutionFinished, ExecutionQueued
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    PeerSought,
    RequestAccepted,
    RequestAdmitted,
    RequestClosed,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
    RequestRelayed,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.handlers.attribution import is_idle, on_shift
from fsar_ledger.runtime.handlers.commands import BeginStep, CloseRequest, Command, CompleteStep, Decides, Reacts, Scheduled, TakeTurn, message
from fsar_ledger.runtime.handlers.policy import compose, own_policy

from .contention import in_order, put_in_order
from .discovery import unanswered


class IssueRequest(Command):
    """The answer has reached the requester."""

    action_id: str


class RelayRequest(Command):
    """The request has reached the doubly trusted peer."""

    action_id: str


class EvaluateRequest(Command):
    """The request has reached the executor."""

    action_id: str


class AdmitReviewed(Command):
    """H_F has approved what policy wanted reviewed."""

    action_id: str


def issue_request(state: State, command: IssueRequest) -> tuple[Event, ...]:
    """The requester has sent its request, its own policy in it; without a candidate it backs off."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    if not request.candidates:
        return (unanswered(state, request),)
    robot, executor = request.requester, request.candidates[0]
    carried = own_policy(state, robot, request.capability, request.task_id)
    return (
        RequestIssued(
            request.task_id,
            request.action_id,
            request.action_id,
            robot,
            robot,
            executor,
            on_shift(state, robot),
            (robot,),
            request.capability,
            carried,
            request.relay,
        ),
    )


def relay_request(state: State, command: RelayRequest) -> tuple[Event, ...]:
    """The peer has passed the request on, its own policy composed."""
    request = state.request.get(command.action_id)
    if request is None or request.relay is None:
        return ()
    carried = stricter(request.carried, own_policy(state, request.relay, request.capability, request.task_id))
    supervisor = on_shift(state, request.relay)
    path = (request.requester, request.relay)
    return (
        RequestRelayed(
            request.task_id,
            request.action_id,
            request.action_id,
            request.relay,
            request.requester,
            request.candidates[0],
            supervisor,
            path,
            carried,
        ),
    )


def evaluate_request(state: State, command: EvaluateRequest) -> tuple[Event, ...]:
    """The executor has admitted or denied the request, or asked H_F for review. Paper: eq:admissible."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    executor = request.candidates[0]
    outcome = compose(state, request.carried, executor, request.capability, request.task_id)
    if outcome == "deny":
        context = _context(state, request, executor)
        return (RequestDenied(*context, reason="policy"),)
    if outcome == "review":
        return (SupervisorCalled(request.task_id, request.action_id, FLEET_SUPERVISOR, "review"),)
    return put_in_order(state, request, executor, _context(state, request, executor)) or _admitted(state, request, executor)


def admit_reviewed(state: State, command: AdmitReviewed) -> tuple[Event, ...]:
    """The executor has admitted the approved request."""
    request = state.request.get(command.action_id)
    return () if request is None else _admitted(state, request, request.candidates[0])


def _context(state: State, request: Request, executor: str) -> tuple[str, str, str, str, str, str, str | None, tuple[str, ...]]:
    """The envelope of what the executor decides about the request."""
    supervisor = on_shift(state, executor)
    return request.task_id, request.action_id, request.action_id, executor, request.requester, executor, supervisor, (executor,)


def _admitted(state: State, request: Request, executor: str) -> tuple[Event, ...]:
    context = _context(state, request, executor)
    queued = ExecutionQueued(
        request.task_id,
        request.action_id,
        request.requester,
        executor,
        on_shift(state, executor),
        executor,
        request.requester,
        request.capability,
        request.step,
        request.attempt,
        True,
        True,
        True,
    )
    admitted = RequestAdmitted(*context, outcome="allow")
    if is_idle(state, executor):
        return (admitted, queued)
    return (admitted, RequestDeferred(*context), queued)


def take_turn(state: State, command: TakeTurn) -> tuple[Event, ...]:
    """The executor has accepted, claims execution and override, and approaches. Paper: eq:auth."""
    action = state.execution.actions.get(command.action_id)
    if action is None or action.stage != "queued":
        return ()
    robot = action.robot
    context = (action.task_id, action.action_id, action.action_id, robot, action.requested_by, robot, on_shift(state, robot), (robot,))
    return (
        RequestAccepted(*context),
        AuthorityClaimed(action.task_id, action.action_id, "execution", robot, "acceptance"),
        AuthorityClaimed(action.task_id, action.action_id, "override", robot, "acceptance"),
        ApproachStarted(action.task_id, action.action_id, robot),
    )


def close_request(state: State, command: CloseRequest) -> tuple[Event, ...]:
    """The coordination engine has closed the request. Paper: sec:architecture:fleet."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    supervisor = on_shift(state, request.requester)
    context = (request.task_id, request.action_id, request.action_id, COORDINATION, request.requester, request.target, supervisor)
    return (RequestClosed(*context, (COORDINATION,)),)


def _on_answer(state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    if event.task_id not in state.task or event.action_id in state.recovery:  # an outsider's request is nobody's step; recovery asks for itself
        return ()
    assert event.action_id is not None
    if state.fleet.configuration == "without-shared-registry":
        return (Scheduled(IssueRequest(event.action_id)),)
    return (Scheduled(IssueRequest(event.action_id), 0, (message(event.action_id, 1),)),)


def _on_request(state: State, event: RequestIssued, _now_us: int) -> tuple[Scheduled, ...]:
    if event.task_id not in state.task:  # an outsider's request is nobody's step
        return ()
    assert event.action_id is not None
    next_one: Command = RelayRequest(event.action_id) if event.relay else EvaluateRequest(event.action_id)
    return (Scheduled(next_one, 0, (message(event.action_id, 2),)),)


def _on_relay(_state: State, event: RequestRelayed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(EvaluateRequest(event.action_id), 0, (message(event.action_id, 3),)),)


def _on_denial(state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    if event.task_id not in state.task:
        return ()
    return (Scheduled(BeginStep(event.task_id), state.fleet.structure.back_off_us),)


def _on_unanswered(state: State, event: RequestUnanswered | PeerSought, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(BeginStep(event.task_id), state.fleet.structure.back_off_us),)


def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    if event.purpose == "ordering":
        waiting = in_order(state, event.action_id, event.preferred)
        return tuple(Scheduled(EvaluateRequest(name), place) for place, name in enumerate(waiting, start=1))
    return (Scheduled(AdmitReviewed(event.action_id)),) if event.purpose == "review" else ()


def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.get(event.action_id)
    if request is None or event.task_id not in state.task:
        return ()
    if event.robot == request.requester:
        return (Scheduled(CompleteStep(event.action_id)),)
    return (Scheduled(CloseRequest(event.action_id), 0, (message(event.action_id, 4),)),)


def _on_close(_state: State, event: RequestClosed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(CompleteStep(event.action_id)),)


DECIDES: Decides = {
    IssueRequest: issue_request,
    RelayRequest: relay_request,
    EvaluateRequest: evaluate_request,
    AdmitReviewed: admit_reviewed,
    TakeTurn: take_turn,
    CloseRequest: close_request,
}
REACTS: Reacts = {
    RegistryQueried: _on_answer,
    RequestIssued: _on_request,
    RequestRelayed: _on_relay,
    RequestDenied: _on_denial,
    RequestUnanswered: _on_unanswered,
    PeerSought: _on_unanswered,
    SupervisorResponded: _on_response,
    ExecutionFinished: _on_finish,
    RequestClosed: _on_close,
}
