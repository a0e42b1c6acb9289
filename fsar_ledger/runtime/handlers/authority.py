"""Authority: rights that supervisors grant and revoke, and the end of claims. Paper: eq:auth, sec:model:authority.

Rights are looked up when a request is evaluated, so a revocation takes effect at the next request boundary: what was
admitted before, queued or executing, continues.
"""

from collections.abc import Iterable
from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.authority import (
    AuthorityClaimed,
    AuthorityGranted,
    AuthorityReleased,
    AuthorityRevoked,
    RevocationReason,
)
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, TRUST, Dimension, OverrideLevel, Principal, Robot, Supervisor
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.trust import RoleTrustSet, TrustSet
from fsar_ledger.projections.authority import LEVELS, Authority, Right
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Registry
from fsar_ledger.projections.trust import is_about

from .commands import CloseExecution, Command, Handlers, RobotCommand, Scheduled, commanded_robot, nobody
from .public import (
    PublicCommand,
    carried_out,
    expired_context,
    made_from,
    rejected,
    unknown_capability,
    unknown_robot,
    unknown_supervisor,
    unknown_word,
)
from .trust import trusts

HANDLERS = Handlers()


class GrantAuthority(PublicCommand):
    """Let the requester request this (None: of anyone, anything, in any context), up to the override level."""

    supervisor: Supervisor
    requester: Robot
    executor: Robot | None
    override: OverrideLevel
    capability: str | None = None
    context: str | None = None


class RevokeAuthority(PublicCommand):
    """Stop letting the requester request this (None: of anyone, anything, in any context)."""

    supervisor: Supervisor
    requester: Robot
    executor: Robot | None
    capability: str | None = None
    context: str | None = None
    reason: RevocationReason = "human override"


class ReleaseAuthority(PublicCommand):
    """Release what the claimant holds of this dimension over the action."""

    claimant: Principal
    action_id: str
    dimension: Dimension


class ExpireContext(Command):
    """End a context in which rights were granted."""

    context: str


class RevokeDistrusted(RobotCommand):
    """Revoke the rights of a peer that the robot trusts less than when it admitted its requests."""

    peer: Robot


def close_execution(state: State, command: CloseExecution) -> tuple[Event, ...]:
    """End authority over the finished execution."""
    return release(state.authority, command.action_id)


def release(authority: Authority, action_id: str, reason: str | None = None) -> tuple[AuthorityReleased, ...]:
    """Release the open claims on the action, all of them or those made for this reason."""
    claims = authority.claims.get(action_id, ())
    return released(claim for claim in claims if reason is None or claim.reason == reason)


def made_for(authority: Authority, reason: str) -> list[AuthorityClaimed]:
    """Return the open claims on any action that were made for this reason."""
    return [claim for claims in authority.claims.values() for claim in claims if claim.reason == reason]


def released(claims: Iterable[AuthorityClaimed]) -> tuple[AuthorityReleased, ...]:
    """Release each of these claims."""
    return tuple(AuthorityReleased(claim.subject, claim.dimension, claim.claimant, claim.reason) for claim in claims)


@HANDLERS.decide(GrantAuthority)
def grant_authority(state: State, command: GrantAuthority) -> tuple[Event, ...]:
    """Let the requester ask up to this level, on the authority of the executor's own supervisor or of H_F.

    Paper: eq:auth, eq:override.
    """
    reason = _unknown(state.fleet, state.registry, command)
    robot = state.fleet.robots.get(command.executor) if command.executor is not None else None
    if (
        reason is None
        and command.supervisor != FLEET_SUPERVISOR
        and (robot is None or robot.supervisor != command.supervisor)
    ):
        reason = (
            f"{command.supervisor} does not supervise {command.executor or 'every robot'}, "
            f"expected {FLEET_SUPERVISOR} or the executor's own"
        )
    reason = (
        reason
        or unknown_word("override level", command.override, LEVELS)
        or expired_context(state.context, command.context)
    )
    if reason is None and command.supervisor != FLEET_SUPERVISOR and _is_revoked_by_fleet(state.authority, command):
        reason = f"{FLEET_SUPERVISOR} has revoked it, expected {FLEET_SUPERVISOR} to lift that"
    return _decided(AuthorityGranted, command, reason)


@HANDLERS.decide(RevokeAuthority)
def revoke_authority(state: State, command: RevokeAuthority) -> tuple[Event, ...]:
    """Stop the requester from asking this, on the authority of either robot's own supervisor or of H_F.

    It takes effect at the next evaluation. Paper: sec:model:authority.
    """
    reason = _unknown(state.fleet, state.registry, command)
    if reason is None and command.supervisor != FLEET_SUPERVISOR:
        parties = [state.fleet.robots[name] for name in (command.requester, command.executor) if name is not None]
        if all(robot.supervisor != command.supervisor for robot in parties):
            reason = f"{command.supervisor} supervises neither robot, expected {FLEET_SUPERVISOR} or one's own"
    reason = reason or unknown_word("reason", command.reason, get_args(RevocationReason))
    if reason is None and isinstance(_standing(state.authority, command), AuthorityRevoked):
        reason = "it is revoked already, expected a right that stands"
    return _decided(AuthorityRevoked, command, reason)


@HANDLERS.decide(ReleaseAuthority)
def release_authority(state: State, command: ReleaseAuthority) -> tuple[Event, ...]:
    """Release the dimension; the authority to execute ends with the execution only."""
    claims = state.authority.claims.get(command.action_id, ())
    matching = tuple(
        claim for claim in claims if (claim.claimant, claim.dimension) == (command.claimant, command.dimension)
    )
    if not matching:
        reason = f"{command.claimant} holds no {command.dimension} authority over it, expected an open claim"
        return rejected(command, command.action_id, reason, command.claimant)
    action = state.execution.actions.get(command.action_id)
    if command.dimension == "execution" and action is not None and action.robot == command.claimant:
        reason = f"{command.claimant} has yet to finish it, expected the result first"
        return rejected(command, command.action_id, reason, command.claimant)
    return released(matching)


@HANDLERS.decide(ExpireContext, nobody)
def expire_context(state: State, command: ExpireContext) -> tuple[AuthorityRevoked, ...]:
    """End the rights that were granted for the context. Paper: sec:model:authority (context expiration)."""
    return tuple(
        AuthorityRevoked(
            requested_by=right.requested_by,
            executed_by=right.executed_by,
            capability=right.capability,
            context=right.context,
            reason="context expired",
            decided_by=TRUST,
        )
        for right in _in_context(state.authority, command.context)
    )


@HANDLERS.decide(RevokeDistrusted, commanded_robot)
def revoke_distrusted(state: State, command: RevokeDistrusted) -> tuple[AuthorityRevoked, ...]:
    """Revoke the rights that the peer is no longer trusted with; what was admitted continues.

    Paper: sec:model:authority (trust downgrade).
    """
    about = {(action.capability, action.task_id): None for action in _distrusted(state, command.robot, command.peer)}
    revoked = (
        AuthorityRevoked(
            requested_by=command.peer,
            executed_by=command.robot,
            capability=capability,
            context=context,
            reason="trust downgrade",
            decided_by=TRUST,
        )
        for capability, context in about
    )
    return tuple(right for right in revoked if not isinstance(_latest(state.authority, right), AuthorityRevoked))


def _unknown(fleet: Fleet, registry: Registry, command: GrantAuthority | RevokeAuthority) -> str | None:
    reason = unknown_supervisor(fleet, command.supervisor) or unknown_robot(fleet, command.requester, command.executor)
    if reason is None and command.requester == command.executor:
        reason = f"{command.requester} needs nobody's authority to ask itself, expected two robots"
    return reason or unknown_capability(registry, command.capability)


def _decided(
    kind: type[AuthorityGranted | AuthorityRevoked], command: GrantAuthority | RevokeAuthority, refused: str | None
) -> tuple[Event, ...]:
    """Return the decision about the requester's right, or the command's rejection if it is refused."""
    names = {"requested_by": command.requester, "executed_by": command.executor, "decided_by": command.supervisor}
    return carried_out(command, command.requester, refused, command.supervisor, made_from(kind, command, **names))


def _latest(authority: Authority, about: AuthorityRevoked) -> Right | None:
    """Return the last right with the same robots, capability and context."""
    return next((right for right in reversed(authority.rights) if _subject(right) == _subject(about)), None)


def _subject(right: Right) -> tuple[str, str | None, str | None, str | None]:
    return right.requested_by, right.executed_by, right.capability, right.context


def _covers(right: Right, command: GrantAuthority | RevokeAuthority) -> bool:
    """Return whether the right covers everything that the command is about."""
    pairs = (
        (right.executed_by, command.executor),
        (right.capability, command.capability),
        (right.context, command.context),
    )
    return right.requested_by == command.requester and all(covering in (None, covered) for covering, covered in pairs)


def _overlaps(right: Right, command: GrantAuthority) -> bool:
    """Return whether the right and the command can concern the same request."""
    pairs = (
        (right.executed_by, command.executor),
        (right.capability, command.capability),
        (right.context, command.context),
    )
    return right.requested_by == command.requester and all(None in pair or pair[0] == pair[1] for pair in pairs)


def _standing(authority: Authority, command: RevokeAuthority) -> Right | None:
    """Return the last right that covers the command, if no later one is about a part of it."""
    for right in reversed(authority.rights):
        if _covers(right, command):
            return right
        if right.requested_by == command.requester and isinstance(right, AuthorityGranted):
            return None
    return None


def _is_revoked_by_fleet(authority: Authority, command: GrantAuthority) -> bool:
    """Return whether the grant would lift something that H_F has revoked and not granted again."""
    for right in reversed(authority.rights):
        if right.decided_by == FLEET_SUPERVISOR and _overlaps(right, command):
            return isinstance(right, AuthorityRevoked)
    return False


def _in_context(authority: Authority, context: str) -> tuple[AuthorityGranted, ...]:
    """Return the grants for this context, each once, that were not revoked since."""
    last = {_subject(right): right for right in authority.rights if right.context == context}
    return tuple(right for right in last.values() if isinstance(right, AuthorityGranted))


def _distrusted(state: State, robot: Robot, peer: Robot) -> list[Action]:
    """Return the actions that the robot admitted for the peer and would now refuse for lack of trust.

    The peer is the requester or the relay.
    """
    distrusted = []
    for action in state.execution.actions.values():
        request = state.request.open.get(action.action_id)
        if (
            request is None
            or not action.is_delegated
            or action.robot != robot
            or peer != (request.relay or request.requester)
        ):
            continue
        if not trusts(state, robot, peer, action.capability, action.task_id):
            distrusted.append(action)
    return distrusted


@HANDLERS.react(TaskCompleted, TaskAbandoned)
def _on_end(state: State, event: TaskCompleted | TaskAbandoned, _now_us: int) -> tuple[Scheduled, ...]:
    if not (state.authority.rights and _in_context(state.authority, event.task_id)):
        return ()
    return (Scheduled(ExpireContext(event.task_id)),)


@HANDLERS.react(TrustSet)
def _on_trust(state: State, event: TrustSet, _now_us: int) -> tuple[Scheduled, ...]:
    if not state.execution.actions or not _distrusted(state, event.robot, event.peer):
        return ()
    return (Scheduled(RevokeDistrusted(event.robot, event.peer)),)


@HANDLERS.react(RoleTrustSet)
def _on_role_trust(state: State, event: RoleTrustSet, _now_us: int) -> tuple[Scheduled, ...]:
    """Revoke as `_on_trust` does, for each pair of these roles that has an action in hand."""
    delegated = [
        (action, state.request.open.get(action.action_id))
        for action in state.execution.actions.values()
        if action.is_delegated
    ]
    pairs = {
        (action.robot, request.relay or request.requester): None for action, request in delegated if request is not None
    }
    return tuple(
        Scheduled(RevokeDistrusted(robot, peer))
        for robot, peer in pairs
        if is_about(state.trust, event, robot, peer) and _distrusted(state, robot, peer)
    )
