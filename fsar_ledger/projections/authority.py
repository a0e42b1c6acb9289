"""Claims, rights and approvals: who holds what, who may ask for what. Paper: eq:auth."""

from collections.abc import Container, Mapping
from typing import NamedTuple, TypeVar, assert_never

import msgspec

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityGranted, AuthorityReleased, AuthorityRevoked
from fsar_ledger.events.envelope import OverrideLevel, Robot
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.events.world import PolicyWindowOpened

from . import put, without
from .policy import RoleRule, Rule, key_of

HANDLES = (
    AuthorityClaimed
    | AuthorityReleased
    | AuthorityGranted
    | AuthorityRevoked
    | SupervisorResponded
    | PolicyWindowOpened
    | PolicyRuleSet
    | RolePolicyRuleSet
    | FleetRuleLearned
    | ExecutionFinished
)

LEVELS: tuple[OverrideLevel, ...] = (
    "none",
    "soft-priority",
    "hard-preempt",
    "emergency-only",
)  # from weak to strong, eq:override
Right = AuthorityGranted | AuthorityRevoked
_Key = TypeVar("_Key")


class Since(Container[_Key]):
    """The keys whose last change has at least this number."""

    def __init__(self, changes: Mapping[_Key, int], number: int) -> None:
        self._changes = changes
        self._number = number

    def __contains__(self, key: object) -> bool:
        return self._changes.get(key, -1) >= self._number  # type: ignore[arg-type]  # no other key is there


class Later(NamedTuple):
    """Policy that came after an approval and is not covered by it: windows, rules, and robots that heard of a rule."""

    windows: Container[str]
    rules: Container[Rule | RoleRule]
    heard: Container[Robot]


class Changes(msgspec.Struct, frozen=True, gc=False):
    """Changes of policy since the oldest approval, numbered: the last one of each window, rule and robot that heard."""

    count: int = 0
    windows: Mapping[str, int] = {}
    rules: Mapping[Rule | RoleRule, int] = {}
    heard: Mapping[Robot, int] = {}


class Authority(msgspec.Struct, frozen=True, gc=False):
    """Claims, rights and approvals.

    `claims`: action -> open claims; `rights`: grants and revocations in order; `approvals`: action -> number of the
    next change of policy when it was approved; `changes`: those changes, while there are approvals.
    """

    claims: Mapping[str, tuple[AuthorityClaimed, ...]] = {}
    rights: tuple[Right, ...] = ()
    approvals: Mapping[str, int] = {}
    changes: Changes = Changes()


INITIAL = Authority()


def rank(level: OverrideLevel) -> int:
    """Return the rank of the level from weak (0) to strong. Paper: eq:override."""
    return LEVELS.index(level)


def later_than(state: Authority, action_id: str) -> Later | None:
    """Return the policy that came after the approval of this action, or None if there is none."""
    number, changes = state.approvals.get(action_id), state.changes
    if number is None:
        return None
    return Later(Since(changes.windows, number), Since(changes.rules, number), Since(changes.heard, number))


def right_of(state: Authority, requester: Robot, executor: Robot, capability: str, context: str) -> Right | None:
    """Return the last grant or revocation that concerns this request, or None. Paper: sec:model:authority."""
    for right in reversed(state.rights):
        if (
            right.requested_by == requester
            and right.executed_by in (None, executor)
            and right.capability in (None, capability)
            and right.context in (None, context)
        ):
            return right
    return None


def evolve(state: Authority, event: HANDLES) -> Authority:
    """Return the claims, rights and approvals after the event."""
    match event:
        case AuthorityClaimed():
            open_claims = (*state.claims.get(event.subject.action_id, ()), event)
            claims = put(state.claims, event.subject.action_id, open_claims)
            return Authority(claims, state.rights, state.approvals, state.changes)
        case AuthorityReleased():
            left = tuple(claim for claim in state.claims.get(event.subject.action_id, ()) if _key(claim) != _key(event))
            action = event.subject.action_id
            claims = put(state.claims, action, left) if left else without(state.claims, action)
            return Authority(claims, state.rights, state.approvals, state.changes)
        case PolicyWindowOpened() | PolicyRuleSet() | RolePolicyRuleSet() | FleetRuleLearned():
            if not state.approvals:
                return state
            return Authority(state.claims, state.rights, state.approvals, _with(state.changes, event))
        case ExecutionFinished():
            if event.subject.action_id not in state.approvals:
                return state
            approvals = without(state.approvals, event.subject.action_id)
            return Authority(state.claims, state.rights, approvals, state.changes if approvals else Changes())
        case AuthorityGranted() | AuthorityRevoked():
            return Authority(state.claims, (*state.rights, event), state.approvals, state.changes)
        case SupervisorResponded():
            if event.purpose != "review" or not event.approves:
                return state
            approvals = put(state.approvals, event.subject.action_id, state.changes.count)
            return Authority(state.claims, state.rights, approvals, state.changes)
        case _:
            assert_never(event)


def since(known: Changes, number: int | None) -> Changes:
    """Return the changes from this number on, that of the oldest approval; None: there is no approval."""
    if number is None:
        return Changes()
    windows = {name: last for name, last in known.windows.items() if last >= number}
    rules = {rule: last for rule, last in known.rules.items() if last >= number}
    heard = {robot: last for robot, last in known.heard.items() if last >= number}
    return Changes(known.count, windows, rules, heard)


def _with(
    changes: Changes, event: PolicyWindowOpened | PolicyRuleSet | RolePolicyRuleSet | FleetRuleLearned
) -> Changes:
    """Return the changes with this one."""
    number, count = changes.count, changes.count + 1
    match event:
        case PolicyWindowOpened():
            return Changes(count, put(changes.windows, event.window, number), changes.rules, changes.heard)
        case PolicyRuleSet() | RolePolicyRuleSet():
            return Changes(count, changes.windows, put(changes.rules, key_of(event), number), changes.heard)
        case FleetRuleLearned():
            return Changes(count, changes.windows, changes.rules, put(changes.heard, event.robot, number))
        case _:
            assert_never(event)


def _key(event: AuthorityClaimed | AuthorityReleased) -> tuple[str, str, str]:
    """Return the identity of the claim: a claimant may hold a dimension for two reasons and release only one."""
    return event.dimension, event.claimant, event.reason
