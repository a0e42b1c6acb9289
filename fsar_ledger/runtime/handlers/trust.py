"""Whether one robot lets another ask something of it, and how that trust moves. Paper: eq:trust, eq:delegable."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.envelope import TRUST, Robot, Supervisor, TrustScope
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.request import RequestClosed, RequestDenied
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.trust import RoleTrustSet, TrustSet, TrustThresholdsSet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import advertisement
from fsar_ledger.projections.trust import SCOPES, Key, Trust, covers, follows_record, scope_of

from .commands import Command, Handlers, RobotCommand, Scheduled, commanded_robot, nobody
from .public import (
    PublicCommand,
    carried_out,
    made_from,
    not_for_roles,
    not_in_charge,
    unknown_about,
    unknown_robot,
    unknown_word,
)

BROADEST_BY_RECORD: TrustScope = "session"  # persistent trust is for an operator to give

HANDLERS = Handlers()


class SetTrust(PublicCommand):
    """Set the robot's trust in the peer.

    For one capability, in one context (task), or (None) for all.
    """

    issued_by: Supervisor
    robot: Robot
    peer: Robot
    scope: TrustScope
    capability: str | None = None
    context: str | None = None
    reason: str = "operator"


class SetRoleTrust(PublicCommand):
    """Set the trust of every robot of the role in every robot of the other.

    In a domain or (empty) in the whole fleet.
    """

    issued_by: Supervisor
    role: str
    peer_role: str
    scope: TrustScope
    domain: str = ""
    capability: str | None = None
    context: str | None = None
    reason: str = "operator"


class SetTrustThresholds(PublicCommand):
    """Let trust follow the record.

    So many successes in a row promote it, so many failures downgrade it; 0 is never.
    """

    issued_by: Supervisor
    promote_after: int
    downgrade_after: int


class AssessTrust(RobotCommand):
    """Move trust by the robot's record of the peer.

    In the context, or (None) in those that no trust is set for.
    """

    peer: Robot
    capability: str
    context: str | None = None


class ExpireTrust(Command):
    """End a task that some trust was limited to."""

    task_id: str


def trusts(state: State, executor: Robot, requester: Robot, capability: str, context: str | None = None) -> bool:
    """Return TrustOK: whether trust in the requester covers what the capability's advertisement requires.

    Paper: eq:delegable.
    """
    if "trust-evaluation" in state.fleet.without:
        return True
    record = advertisement(state.registry, executor, capability)
    required: TrustScope = "capability" if record is None else record.trust_required
    return covers(scope_of(state.trust, executor, requester, capability, context), required)


@HANDLERS.decide(SetTrust)
def set_trust(state: State, command: SetTrust) -> tuple[Event, ...]:
    """Set the robot's trust in the peer, on the authority of its own supervisor or of H_F. Paper: eq:trust."""
    refused = unknown_robot(state.fleet, command.robot, command.peer) or not_in_charge(
        state.fleet, command.issued_by, command.robot
    )
    refused = refused or unknown_about(state, command) or unknown_word("scope", command.scope, SCOPES)
    if refused is None and command.robot == command.peer:
        refused = f"{command.robot} needs no trust in itself, expected another robot"
    event = made_from(TrustSet, command, decided_by=command.issued_by)
    return carried_out(command, command.robot, refused, command.issued_by, event)


@HANDLERS.decide(SetRoleTrust)
def set_role_trust(state: State, command: SetRoleTrust) -> tuple[Event, ...]:
    """Set the trust between the roles, for pairs without an entry of their own. Paper: eq:trust."""
    refused = not_for_roles(state, command.issued_by, command.domain, command.role, command.peer_role)
    refused = refused or unknown_about(state, command) or unknown_word("scope", command.scope, SCOPES)
    event = made_from(RoleTrustSet, command, decided_by=command.issued_by)
    return carried_out(command, command.role, refused, command.issued_by, event)


@HANDLERS.decide(SetTrustThresholds)
def set_trust_thresholds(state: State, command: SetTrustThresholds) -> tuple[Event, ...]:
    """Let trust follow the record, on the authority of H_F. Paper: sec:model:trust."""
    refused = not_in_charge(state.fleet, command.issued_by, None, is_fleet_matter=True)
    if refused is None and min(command.promote_after, command.downgrade_after) < 0:
        refused = f"thresholds {command.promote_after} and {command.downgrade_after}, expected 0 (never) or more"
    event = TrustThresholdsSet(command.promote_after, command.downgrade_after, command.issued_by)
    return carried_out(command, "trust", refused, command.issued_by, event)


@HANDLERS.decide(AssessTrust, commanded_robot)
def assess_trust(state: State, command: AssessTrust) -> tuple[Event, ...]:
    """Make trust one scope narrower or broader when the record has reached a threshold; none stays none.

    Paper: sec:model:trust.
    """
    scope = _moved(state.trust, (command.robot, command.peer, command.capability, command.context))
    return () if scope is None else (made_from(TrustSet, command, scope=scope, decided_by=TRUST, reason="record"),)


def _moved(trust: Trust, key: Key) -> TrustScope | None:
    """Return the scope to which the record moves this trust, or None."""
    record, scope = trust.records.get(key), scope_of(trust, *key)
    if record is None or scope == "none":
        return None
    if 0 < trust.downgrade_after <= record.failures:
        return SCOPES[SCOPES.index(scope) - 1]
    if 0 < trust.promote_after <= record.successes and not covers(scope, BROADEST_BY_RECORD):
        return SCOPES[SCOPES.index(scope) + 1]
    return None


@HANDLERS.decide(ExpireTrust, nobody)
def expire_trust(state: State, command: ExpireTrust) -> tuple[Event, ...]:
    """End task-scoped trust that was given in the context of the finished task. Paper: sec:model:trust."""
    of_pairs = [
        TrustSet(
            robot=robot,
            peer=peer,
            scope="none",
            capability=capability,
            context=command.task_id,
            decided_by=TRUST,
            reason="context expired",
        )
        for (robot, peer), entries in state.trust.entries.items()
        for (capability, context), scope in entries.items()
        if context == command.task_id and scope == "task"
    ]
    of_roles = [
        RoleTrustSet(
            role=role,
            peer_role=peer_role,
            scope="none",
            domain=domain,
            capability=capability,
            context=command.task_id,
            decided_by=TRUST,
            reason="context expired",
        )
        for (role, peer_role, domain), entries in state.trust.of_roles.items()
        for (capability, context), scope in entries.items()
        if context == command.task_id and scope == "task"
    ]
    return (*of_pairs, *of_roles)


@HANDLERS.react(RequestClosed, RequestDenied, ExecutionFailed, AuthorityRevoked)
def _on_result(
    state: State, _event: RequestClosed | RequestDenied | ExecutionFailed | AuthorityRevoked, _now_us: int
) -> tuple[Scheduled, ...]:
    """Move trust after each coordination event by which a record reaches a threshold.

    Paper: sec:evaluation:simulator.
    """
    if not follows_record(state.trust):
        return ()
    return tuple(Scheduled(AssessTrust(*key)) for key in state.trust.judged if _moved(state.trust, key) is not None)


@HANDLERS.react(TaskCompleted, TaskAbandoned)
def _on_task_over(state: State, event: TaskCompleted | TaskAbandoned, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(ExpireTrust(event.task_id)),) if event.task_id in state.trust.contexts else ()
