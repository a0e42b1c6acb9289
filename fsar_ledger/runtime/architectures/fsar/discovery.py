"""FSAR: a robot that lacks a capability queries the registry, or peers it met, and then asks one of the candidates.

Paper: sec:model:request, phases 1 to 3.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import REGISTRY, Robot
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import GapDetected, PeerSought, RequestIssued, RequestUnanswered
from fsar_ledger.events.task import StepBegan
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Registry, advertisement, offers
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.attribution import capable, is_idle, nearest_first, recorded_by
from fsar_ledger.runtime.handlers.candidates import Answer, Query, candidates, rejecting_filter
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Handlers,
    Scheduled,
    message,
    nobody,
    open_request,
    requester,
)
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.registry import queried
from fsar_ledger.runtime.handlers.trust import trusts

Found = tuple[tuple[Robot, ...], Robot | None]  # candidates, relay

HANDLERS = Handlers()


class DetectGap(ActionCommand):
    """Detect that the step needs another robot."""


class QueryRegistry(ActionCommand):
    """Deliver the query to the registry."""


class IssueRequest(ActionCommand):
    """Deliver the answer to the requester."""


def discover(state: State, request: Request) -> tuple[Answer, Robot | None]:
    """Return the candidates visible to the requester, idle first, else one robot behind a doubly trusted peer.

    Paper: sec:architecture:registry, eq:nontransitive.
    """
    query = Query(request.requester, request.capability, request.task_id)
    answer = candidates(state, query)
    if answer.candidates:
        return answer, None
    for name in sorted(_untrusting(state, query, answer), key=lambda name: not is_idle(state.execution, name)):
        for peer in _relays(state, request, name):
            kept = [index for index, robot in enumerate(answer.rejected) if robot != name]
            rejected = tuple(answer.rejected[index] for index in kept)
            rejected_by = tuple(answer.rejected_by[index] for index in kept)
            return Answer((name,), (request.capability,), rejected, rejected_by, answer.domain, answer.as_of_us), peer
    return answer, None


def _untrusting(state: State, query: Query, answer: Answer) -> list[Robot]:
    """Return the robots that were left out for lack of trust alone, nearest team first.

    A peer that both sides trust may ask them.
    """
    robots = []
    for name, excluded_by in zip(answer.rejected, answer.rejected_by, strict=True):
        record = advertisement(state.registry, name, query.capability)
        if (
            excluded_by == "trust"
            and record is not None
            and rejecting_filter(state, query, record, but="trust") is None
        ):
            robots.append(name)
    return robots


def _visible(fleet: Fleet, registry: Registry, request: Request) -> list[Robot]:
    """Return capable robots whose advertisement the requester's role may see, nearest team first.

    Paper: eq:advertise.
    """
    role = fleet.robots[request.requester].role
    roles = {offer.robot: offer.visible_to for offer in offers(registry.offers, request.capability)}
    is_open = "trust-evaluation" in fleet.without
    return [
        name
        for name in capable(fleet, registry, request.capability, request.requester)
        if is_open or not roles[name] or role in roles[name]
    ]


def _relays(state: State, request: Request, name: Robot) -> list[Robot]:
    """Return peers that both requester and executor trust, nearest team first.

    Each link is then admissible by itself.
    """
    others = [
        peer
        for peer in state.fleet.robots
        if peer not in (name, request.requester) and peer not in {**state.registry.silent, **state.fleet.departed}
    ]
    about = (request.capability, request.task_id)
    near = nearest_first(state.fleet, others, request.requester)
    return [
        peer for peer in near if trusts(state, peer, request.requester, *about) and trusts(state, name, peer, *about)
    ]


@HANDLERS.decide_on(open_request, DetectGap, requester)
def detect_gap(state: State, command: DetectGap, request: Request) -> tuple[Event, ...]:
    """Record that the requester needs another robot; without a registry, search the peers it met."""
    answer: tuple[Event, ...] = ()
    if "shared-registry" in state.fleet.without:
        peers, relay = _among_met(state, request, command.now_us)
        if not peers:
            if request.attempt > 1:
                return (PeerSought(request.subject, request.requester),)
            return (unanswered(state, request),)
        answer = (_met(state, request, peers, relay),)
    return (
        GapDetected(
            request.subject,
            recorded_by(state, request.requester, requested_by=request.requester, executed_by=None),
            request.capability,
        ),
        *answer,
    )


def _among_met(state: State, request: Request, now_us: int) -> Found:
    """Return candidates among robots met recently, judging each link of a chain by itself."""
    met = state.knowledge.met

    def knows(robot: Robot, peer: Robot) -> bool:
        return met.get((robot, peer), -1) >= now_us

    visible = _visible(state.fleet, state.registry, request)
    direct = tuple(
        name
        for name in visible
        if trusts(state, name, request.requester, request.capability, request.task_id)
        and knows(request.requester, name)
    )
    if direct:
        return direct, None
    for name in visible:
        if trusts(state, name, request.requester, request.capability, request.task_id):
            continue
        for peer in _relays(state, request, name):
            if knows(request.requester, peer) and knows(peer, name):
                return (name,), peer
    return (), None


def unanswered(state: State, request: Request, executor: Robot | None = None) -> RequestUnanswered:
    """Return the event that the requester knows no robot to ask, or that this executor did not answer."""
    robot = request.requester
    return RequestUnanswered(
        request.subject,
        recorded_by(state, robot, requested_by=robot, executed_by=executor).decided(robot),
        request.capability,
    )


def _met(state: State, request: Request, robots: tuple[Robot, ...], relay: Robot | None) -> RegistryQueried:
    """Return the record of an answer from memory, which gives no reasons for excluded robots."""
    query = Query(request.requester, request.capability, request.task_id)
    answer = Answer(robots, (request.capability,) * len(robots), (), ())
    return queried(state, query, answer, request.task_id, request.action_id, relay)


@HANDLERS.decide_on(open_request, QueryRegistry, nobody)
def query_registry(state: State, _command: QueryRegistry, request: Request) -> tuple[Event, ...]:
    """Answer the query from the registry, governed by trust and visibility."""
    query = Query(request.requester, request.capability, request.task_id)
    answer, relay = discover(state, request)
    return (queried(state, query, answer, request.task_id, request.action_id, relay),)


@HANDLERS.decide_on(open_request, IssueRequest, requester)
def issue_request(state: State, _command: IssueRequest, request: Request) -> tuple[Event, ...]:
    """Send the request with the requester's own policy; back off without a candidate."""
    if request.is_over:  # one of its robots has left the fleet meanwhile
        return ()
    if not request.candidates:
        return (unanswered(state, request),)
    robot, executor = request.requester, request.candidates[0]
    parties = recorded_by(state, robot, requested_by=robot, executed_by=executor)
    return (
        RequestIssued(
            subject=request.request_subject,
            principals=parties.decided(robot),
            capability=request.capability,
            carried_policy=own_policy(state.policy, state.world, robot, request.capability, request.task_id),
            relay=request.relay,
        ),
    )


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DetectGap(event.subject.action_id)),) if event.target_role is not None else ()


@HANDLERS.react(GapDetected)
def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    if (
        "shared-registry" in state.fleet.without
        or event.subject.task_id not in state.task
        or event.subject.action_id not in state.request.open
    ):
        return ()  # a request that is not a step names its executor
    assert event.subject.action_id is not None
    return (
        Scheduled(
            QueryRegistry(event.subject.action_id),
            0,
            (message(event.principals.requested_by, event.subject.action_id, 0),),
        ),
    )


@HANDLERS.react(RegistryQueried)
def _on_answer(state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    if (
        event.subject.task_id not in state.task or event.subject.action_id in state.recovery
    ):  # an outsider's request is no step; recovery queries by itself
        return ()
    assert event.subject.action_id is not None
    if "shared-registry" in state.fleet.without:
        return (Scheduled(IssueRequest(event.subject.action_id)),)
    return (Scheduled(IssueRequest(event.subject.action_id), 0, (message(REGISTRY, event.subject.action_id, 1),)),)
