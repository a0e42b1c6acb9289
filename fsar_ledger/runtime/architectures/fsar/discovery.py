"""FSAR: a robot that lacks a capability asks the registry, or the peers it met, who could help. Paper: sec:model:request, phases 1 and 2."""

from fsar_ledger.events import Event
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import GapDetected, PeerSought, RequestUnanswered
from fsar_ledger.events.task import StepBegan
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import offers
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.attribution import capable, is_idle, nearest_first, on_shift
from fsar_ledger.runtime.handlers.commands import Command, Decides, Reacts, Scheduled, message
from fsar_ledger.runtime.handlers.trust import trusts

Found = tuple[tuple[str, ...], str | None]  # candidates, relay


class DetectGap(Command):
    """The step needs another robot."""

    action_id: str


class QueryRegistry(Command):
    """The query has reached the registry."""

    action_id: str


def discover(state: State, request: Request) -> Found:
    """The candidates that the registry may show the requester, idle first; else those behind a doubly trusted peer.

    Paper: sec:architecture:registry, eq:nontransitive.
    """
    visible = _visible(state, request)
    direct = [name for name in visible if trusts(state, name, request.requester, request.capability, request.task_id)]
    if direct:
        return tuple(sorted(direct, key=lambda name: not is_idle(state, name))), None
    for name in sorted(visible, key=lambda name: not is_idle(state, name)):
        for peer in _relays(state, request, name):
            return (name,), peer
    return (), None


def _visible(state: State, request: Request) -> list[str]:
    """Capable robots whose advertisement the requester's role may see, nearest team first. Paper: eq:advertise."""
    role = state.fleet.robots[request.requester].role
    roles = {offer.robot: offer.visible_to for offer in offers(state.registry.offers, request.capability)}
    is_open = state.fleet.configuration == "without-trust-evaluation"
    return [name for name in capable(state, request.capability, request.requester) if is_open or not roles[name] or role in roles[name]]


def _relays(state: State, request: Request, name: str) -> list[str]:
    """Peers that both the requester and the executor trust, so that each link is admissible by itself, nearest team first."""
    others = [peer for peer in state.fleet.robots if peer not in (name, request.requester)]
    about = (request.capability, request.task_id)
    near = nearest_first(state, others, request.requester)
    return [peer for peer in near if trusts(state, peer, request.requester, *about) and trusts(state, name, peer, *about)]


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
            return (unanswered(state, request),)
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
    direct = tuple(name for name in visible if trusts(state, name, request.requester, request.capability, request.task_id) and knows(request.requester, name))
    if direct:
        return direct, None
    for name in visible:
        if trusts(state, name, request.requester, request.capability, request.task_id):
            continue
        for peer in _relays(state, request, name):
            if knows(request.requester, peer) and knows(peer, name):
                return (name,), peer
    return (), None


def unanswered(state: State, request: Request) -> RequestUnanswered:
    """The requester knows of nobody to ask."""
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


def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DetectGap(event.action_id)),) if event.target_role is not None else ()


def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    if state.fleet.configuration == "without-shared-registry" or event.task_id not in state.task or event.action_id not in state.request:
        return ()  # a request that is no step names whom it asks
    assert event.action_id is not None
    return (Scheduled(QueryRegistry(event.action_id), 0, (message(event.action_id, 0),)),)


DECIDES: Decides = {DetectGap: detect_gap, QueryRegistry: query_registry}
REACTS: Reacts = {StepBegan: _on_step, GapDetected: _on_gap}
