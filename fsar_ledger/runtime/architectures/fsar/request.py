"""FSAR: a delegated step is a governed request between two robots. Paper: sec:model:request, eq:admissible."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import COORDINATION, FLEET_SUPERVISOR, PolicyOutcome
from fsar_ledger.events.execution import ApproachStarted, ExecutionFinished, ExecutionQueued
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    GapDetected,
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
from fsar_ledger.events.task import StepBegan
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.handlers.attribution import capable, is_idle, nearest_first, on_shift
from fsar_ledger.runtime.handlers.commands import BeginStep, CloseRequest, Command, CompleteStep, Decides, Reacts, Scheduled, TakeTurn, message

Found = tuple[tuple[str, ...], str | None]  # candidates, relay


class DetectGap(Command):
    """The step needs another robot."""

    action_id: str


class QueryRegistry(Command):
    """The query has reached the registry."""

    action_id: str


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


def trusts(state: State, robot: str, peer: str) -> bool:
    """TrustOK: the robot lets the peer ask something of it. Paper: eq:delegable."""
    return state.fleet.configuration == "without-trust-evaluation" or state.trust.get((robot, peer), "none") != "none"


def discover(state: State, request: Request) -> Found:
    """The candidates that the registry may show the requester, idle first; else those behind a doubly trusted peer.

    Paper: sec:architecture:registry, eq:nontransitive.
    """
    visible = _visible(state, request)
    direct = [name for name in visible if trusts(state, name, request.requester)]
    if direct:
        return tuple(sorted(direct, key=lambda name: not is_idle(state, name))), None
    for name in sorted(visible, key=lambda name: not is_idle(state, name)):
        for peer in _relays(state, request, name):
            return (name,), peer
    return (), None


def _visible(state: State, request: Request) -> list[str]:
    """Capable robots whose advertisement the requester's role may see, nearest team first. Paper: eq:advertise."""
    role = state.fleet.robots[request.requester].role
    roles = dict(state.registry.get(request.capability, ()))
    is_open = state.fleet.configuration == "without-trust-evaluation"
    return [name for name in capable(state, request.capability, request.requester) if is_open or not roles[name] or role in roles[name]]


def _relays(state: State, request: Request, name: str) -> list[str]:
    """Peers that both the requester and the executor trust, so that each link is admissible by itself, nearest team first."""
    others = [peer for peer in state.fleet.robots if peer not in (name, request.requester)]
    return [peer for peer in nearest_first(state, others, request.requester) if trusts(state, peer, request.requester) and trusts(state, name, peer)]


def compose(state: State, request: Request, executor: str) -> PolicyOutcome:
    """The outcome of requester's (as carried), executor's and fleet's policy together. Paper: eq:policy."""
    own = in_force(state.world.local, executor)
    if state.fleet.configuration == "without-policy-composition":
        return own
    return stricter(request.carried, stricter(own, state.knowledge.fleet_rule.get(executor, "allow")))


def detect_gap(state: State, command: DetectGap) -> tuple[Event, ...]:
    """The requester has found that it needs another robot; without a registry it looks among the peers it met."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    found: tuple[Event, ...] = ()
    if state.fleet.configuration == "without-shared-registry":
        candidates, relay = _among_met(state, request, command.now_us)
        if not candidates:
            if request.attempt > 1:
                return (PeerSought(request.task_id, request.action_id, request.requester),)
            return (_unanswered(state, request),)
        found = (_queried(state, request, candidates, relay),)
    return (
        GapDetected(request.task_id, request.action_id, request.requester, None, on_shift(state, request.requester), request.capability),
        *found,
    )


def _among_met(state: State, request: Request, now_us: int) -> Found:
    """The same without a registry: only robots that were met lately, each link of a chain by itself."""
    met = state.knowledge.met

    def knows(robot: str, peer: str) -> bool:
        return met.get((robot, peer), -1) >= now_us

    visible = _visible(state, request)
    direct = tuple(name for name in visible if trusts(state, name, request.requester) and knows(request.requester, name))
    if direct:
        return direct, None
    for name in visible:
        if trusts(state, name, request.requester):
            continue
        for peer in _relays(state, request, name):
            if knows(request.requester, peer) and knows(peer, name):
                return (name,), peer
    return (), None


def _unanswered(state: State, request: Request) -> RequestUnanswered:
    robot = request.requester
    supervisor = on_shift(state, robot)
    return RequestUnanswered(request.task_id, request.action_id, robot, robot, None, supervisor, (robot,), request.capability)


def _queried(state: State, request: Request, candidates: tuple[str, ...], relay: str | None) -> RegistryQueried:
    supervisor = on_shift(state, request.requester)
    executor = candidates[0] if candidates else None
    return RegistryQueried(request.task_id, request.action_id, request.requester, executor, supervisor, request.capability, candidates, relay)


def query_registry(state: State, command: QueryRegistry) -> tuple[Event, ...]:
    """The registry has answered, governed by trust and visibility."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    candidates, relay = discover(state, request)
    return (_queried(state, request, candidates, relay),)


def issue_request(state: State, command: IssueRequest) -> tuple[Event, ...]:
    """The requester has sent its request, its own policy in it; without a candidate it backs off."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    if not request.candidates:
        return (_unanswered(state, request),)
    robot, executor = request.requester, request.candidates[0]
    carried = in_force(state.world.local, robot)
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
    carried = stricter(request.carried, in_force(state.world.local, request.relay))
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
    outcome = compose(state, request, executor)
    if outcome == "deny":
        context = _context(state, request, executor)
        return (RequestDenied(*context, reason="policy"),)
    if outcome == "review":
        return (SupervisorCalled(request.task_id, request.action_id, FLEET_SUPERVISOR, "review"),)
    return _admitted(state, request, executor)


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


def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DetectGap(event.action_id)),) if event.target_role is not None else ()


def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    if state.fleet.configuration == "without-shared-registry" or event.task_id not in state.task:
        return ()
    assert event.action_id is not None
    return (Scheduled(QueryRegistry(event.action_id), 0, (message(event.action_id, 0),)),)


def _on_answer(state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    if event.task_id not in state.task:  # an outsider's request is nobody's step
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


def _on_response(_state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
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
    DetectGap: detect_gap,
    QueryRegistry: query_registry,
    IssueRequest: issue_request,
    RelayRequest: relay_request,
    EvaluateRequest: evaluate_request,
    AdmitReviewed: admit_reviewed,
    TakeTurn: take_turn,
    CloseRequest: close_request,
}
REACTS: Reacts = {
    StepBegan: _on_step,
    GapDetected: _on_gap,
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
