"""FSAR: authority ends with the execution; a revocation waits for the request boundary. Paper: sec:model:authority."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, REGISTRY, Parties, Robot, Subject
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued
from fsar_ledger.events.knowledge import PeerRemembered
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import GapDetected, RequestAccepted, RequestAdmitted, RequestDenied, RequestIssued
from fsar_ledger.events.world import ContextChanged, OutsiderRequestInjected, PeersMet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import advertisement
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import is_linked
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.authority import close_execution
from fsar_ledger.runtime.handlers.candidates import Query, rejecting_filter
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    CloseExecution,
    Handlers,
    RobotCommand,
    Scheduled,
    commanded_robot,
    message,
    nobody,
    open_request,
)

HANDLERS = Handlers()


class Revoke(RobotCommand):
    """Claim override over what others execute for a requester whose context has changed."""


class AnswerOutsider(ActionCommand):
    """Answer a request without trust that has reached the registry."""


class RememberPeer(RobotCommand):
    """Let two robots that have met remember each other."""

    peer: Robot


@HANDLERS.decide(Revoke, commanded_robot)
def revoke(state: State, command: Revoke) -> tuple[Event, ...]:
    """Let the requester claim override over what runs for it, until the next request boundary."""
    if command.robot in state.fleet.departed:
        return ()
    revoked: list[Event] = []
    for action in map(state.execution.actions.__getitem__, _claimed(state, command.robot)):
        claims = state.authority.claims[action.action_id]
        if action.robot != command.robot and all(
            claim.claimant != command.robot or claim.dimension != "override" for claim in claims
        ):
            revoked.append(
                AuthorityClaimed(
                    subject=action.subject,
                    dimension="override",
                    claimant=command.robot,
                    reason="revocation",
                    fence=state.fleet.fences.get(command.robot),
                )
            )
    return tuple(revoked)


def _claimed(state: State, robot: Robot) -> list[str]:
    """Return the claimed actions on behalf of the robot, in the order of their first claims."""
    claimed = [action for action in state.execution.served.get(robot, ()) if action in state.authority.claims]
    return claimed if len(claimed) < 2 else [action for action in state.authority.claims if action in claimed]


@HANDLERS.decide_on(open_request, AnswerOutsider, nobody)
def answer_outsider(state: State, _command: AnswerOutsider, request: Request) -> tuple[Event, ...]:
    """Deny what the registry does not show; without trust evaluation, run the request."""
    if request.target is None:
        return ()
    subject, robot, peer, capability = request.subject, request.requester, request.target, request.capability
    if "trust-evaluation" not in state.fleet.without or peer in state.fleet.departed:
        unexecuted = recorded_by(state, robot, requested_by=robot, executed_by=None)
        return (
            _refused(state, request.task_id, robot, peer, capability),
            RequestDenied(request.request_subject, unexecuted.decided(REGISTRY), "advertisement"),
        )
    parties = Parties(requested_by=robot, executed_by=peer, supervised_by=None)
    asking, executing = parties.decided(robot), parties.decided(peer)
    return (
        GapDetected(subject, parties, capability),
        RegistryQueried(subject=subject, principals=parties, capability=capability, candidates=(peer,)),
        RequestIssued(
            subject=request.request_subject, principals=asking, capability=capability, carried_policy="allow"
        ),
        RequestAdmitted(subject=request.request_subject, principals=executing, outcome="allow"),
        RequestAccepted(request.request_subject, executing),
        AuthorityClaimed(
            subject=subject,
            dimension="execution",
            claimant=peer,
            reason="acceptance",
            fence=state.fleet.fences.get(peer),
        ),
        AuthorityClaimed(
            subject=subject,
            dimension="audit",
            claimant=robot,
            reason="no trust scope",
            fence=state.fleet.fences.get(robot),
        ),
        AuthorityClaimed(subject=subject, dimension="audit", claimant=FLEET_SUPERVISOR, reason="no trust scope"),
        ExecutionQueued(
            subject=subject,
            principals=parties,
            robot=peer,
            on_behalf_of=robot,
            capability=capability,
            step=0,
            attempt=1,
            is_delegated=True,
            has_approach=False,
            is_supervised=False,
        ),
    )


# See docs/decisions/refusals-name-the-robot-asked.md.
def _refused(state: State, task_id: str, robot: Robot, peer: Robot, capability: str) -> RegistryQueried:
    """Return the registry's answer to an outsider, with the filter that excludes the requested robot.

    The filter is visibility if the robot is advertised to no one.
    """
    record = advertisement(state.registry, peer, capability)
    excluded_by = None if record is None else rejecting_filter(state, Query(robot, capability, task_id), record)
    return RegistryQueried(
        subject=Subject(task_id, task_id),
        principals=recorded_by(state, robot, requested_by=robot, executed_by=peer),
        capability=capability,
        candidates=(),
        rejected=(peer,),
        rejected_by=(excluded_by or "visibility",),
    )


@HANDLERS.decide(RememberPeer, commanded_robot)
def remember_peer(state: State, command: RememberPeer) -> tuple[Event, ...]:
    """Record that both robots remember each other for a while."""
    until_us = command.now_us + state.fleet.structure.encounter_memory_us
    return (
        PeerRemembered(command.robot, command.peer, until_us),
        PeerRemembered(command.peer, command.robot, until_us),
    )


@HANDLERS.react(ExecutionFinished)
def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    if event.subject.action_id not in state.authority.claims:
        return ()
    return (Scheduled(CloseExecution(event.subject.action_id)),)


@HANDLERS.react(ContextChanged)
def _on_context(state: State, event: ContextChanged, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(Revoke(event.robot)),) if _claimed(state, event.robot) else ()


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(AnswerOutsider(event.task_id), 0, (message(event.robot, event.task_id, 0),)),)


@HANDLERS.react(PeersMet)
def _on_meeting(state: State, event: PeersMet, _now_us: int) -> tuple[Scheduled, ...]:
    """Let two robots that meet remember each other, if both are linked."""
    if "shared-registry" not in state.fleet.without or not all(
        is_linked(state.world, robot) for robot in (event.robot, event.peer)
    ):
        return ()
    return (Scheduled(RememberPeer(event.robot, event.peer)),)


HANDLERS.decide(CloseExecution, nobody)(close_execution)
