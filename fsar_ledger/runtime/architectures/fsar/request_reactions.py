"""FSAR: what follows when something happens to a request."""

from fsar_ledger.events.envelope import REGISTRY
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    OfferAnswered,
    PeerSought,
    RequestAdmitted,
    RequestClosed,
    RequestCountered,
    RequestDenied,
    RequestIssued,
    RequestRelayed,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import Tasks
from fsar_ledger.runtime.handlers.commands import (
    BeginStep,
    CloseRequest,
    Command,
    CompleteStep,
    Handlers,
    Scheduled,
    at_once,
    message,
)

from .contention import held_up, in_order
from .request import AdmitReviewed, EvaluateRequest, GoOnWithout, IssueRequest, RelayRequest

HANDLERS = Handlers()


def _is_step(tasks: Tasks, request: Request | None) -> bool:
    """Tell whether the request is a step of an open task, not an outsider's or a robot's own."""
    return request is not None and not request.is_adhoc and request.task_id in tasks


@HANDLERS.react(RegistryQueried)
def _on_answer(state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    if (
        event.subject.task_id not in state.task or event.subject.action_id in state.recovery
    ):  # an outsider's request is nobody's step; recovery asks for itself
        return ()
    assert event.subject.action_id is not None
    if "shared-registry" in state.fleet.without:
        return (Scheduled(IssueRequest(event.subject.action_id)),)
    return (Scheduled(IssueRequest(event.subject.action_id), 0, (message(REGISTRY, event.subject.action_id, 1),)),)


@HANDLERS.react(RequestIssued)
def _on_request(state: State, event: RequestIssued, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    request = state.request.open.get(event.subject.action_id)
    if request is None or not (request.is_adhoc or _is_step(state.task, request)):
        return ()
    next_one: Command = (
        RelayRequest(event.subject.action_id) if event.relay else EvaluateRequest(event.subject.action_id)
    )
    asked = Scheduled(next_one, 0, (message(request.requester, event.subject.action_id, 2),))
    return (
        asked,
        Scheduled(GoOnWithout(event.subject.action_id), state.fleet.answer_us, (at_once(request.requester),)),
    )


@HANDLERS.react(RequestRelayed)
def _on_relay(state: State, event: RequestRelayed, _now_us: int) -> tuple[Scheduled, ...]:
    asked = Scheduled(
        EvaluateRequest(event.subject.action_id), 0, (message(event.principals.decided_by, event.subject.action_id, 3),)
    )
    late = GoOnWithout(event.subject.action_id, is_relayed=True)
    return (asked, Scheduled(late, state.fleet.answer_us, (at_once(event.principals.requested_by),)))


@HANDLERS.react(RequestDenied)
def _on_denial(state: State, event: RequestDenied, now_us: int) -> tuple[Scheduled, ...]:
    return (*_again(state, event.subject.action_id), *_let_pass(state, event, now_us))


@HANDLERS.react(RequestAdmitted, RequestCountered)
def _let_pass(
    state: State, event: RequestAdmitted | RequestCountered | RequestDenied, _now_us: int
) -> tuple[Scheduled, ...]:
    """Evaluate again the requests that waited for one that H_F let go first."""
    if not state.contention.orders:
        return ()
    return tuple(
        Scheduled(EvaluateRequest(name), place)
        for place, name in enumerate(held_up(state.contention, event.subject.action_id), start=1)
    )


@HANDLERS.react(OfferAnswered)
def _on_offer(state: State, event: OfferAnswered, _now_us: int) -> tuple[Scheduled, ...]:
    """Evaluate the changed request again, or retry a step whose requester let go."""
    assert event.subject.action_id is not None
    if event.override is None:
        return _again(state, event.subject.action_id)
    return (
        Scheduled(
            EvaluateRequest(event.subject.action_id),
            0,
            (message(event.principals.requested_by, event.subject.action_id, f"offer{event.round}"),),
        ),
    )


def _again(state: State, action_id: str | None) -> tuple[Scheduled, ...]:
    request = state.request.open.get(action_id or "")
    if request is None or not _is_step(state.task, request):
        return ()
    return (Scheduled(BeginStep(request.task_id, request.action_id), state.fleet.structure.back_off_us),)


@HANDLERS.react(RequestUnanswered, PeerSought)
def _on_unanswered(state: State, event: RequestUnanswered | PeerSought, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(BeginStep(event.subject.task_id, event.subject.action_id), state.fleet.structure.back_off_us),)


@HANDLERS.react(SupervisorResponded)
def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    if event.purpose == "ordering":
        waiting = in_order(state.contention, event.subject.action_id, event.preferred)
        return tuple(Scheduled(EvaluateRequest(name), place) for place, name in enumerate(waiting, start=1))
    return (
        (Scheduled(AdmitReviewed(event.subject.action_id, event.approves), 1, (at_once(event.principals.decided_by),)),)
        if event.purpose == "review"
        else ()
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
    return (
        (Scheduled(CompleteStep(event.subject.action_id)),)
        if event.result == "success"
        else _again(state, event.subject.action_id)
    )


@HANDLERS.react(RequestClosed)
def _on_close(state: State, event: RequestClosed, _now_us: int) -> tuple[Scheduled, ...]:
    """Complete the step, or retry later a step that did not succeed."""
    if not _is_step(state.task, state.request.open.get(event.subject.action_id)):
        return ()
    done = Scheduled(CompleteStep(event.subject.action_id), 1, (at_once(event.principals.decided_by),))
    return (done,) if event.result == "success" else _again(state, event.subject.action_id)
