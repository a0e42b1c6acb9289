"""Claims, rights and approvals: who holds what, who may ask for what. Paper: eq:auth."""

from typing import assert_never

import msgspec

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityGranted, AuthorityReleased, AuthorityRevoked
from fsar_ledger.events.envelope import OverrideLevel, PolicyOutcome, Robot
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.events.world import PolicyWindowOpened

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


class Later(msgspec.Struct, frozen=True, gc=False):
    """Policy that came after an approval and is not covered by it: windows, rules, and fleet rules heard, by robot."""

    windows: frozenset[str] = frozenset()
    rules: frozenset[Rule | RoleRule] = frozenset()
    heard: dict[Robot, PolicyOutcome] = {}


class Authority(msgspec.Struct, frozen=True, gc=False):
    """Claims, rights and approvals.

    `claims`: action -> open claims; `rights`: grants and revocations in order; `approvals`: action -> later policy.
    """

    claims: dict[str, tuple[AuthorityClaimed, ...]] = {}
    rights: tuple[Right, ...] = ()
    approvals: dict[str, Later] = {}


INITIAL = Authority()


def rank(level: OverrideLevel) -> int:
    """Return the rank of the level from weak (0) to strong. Paper: eq:override."""
    return LEVELS.index(level)


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
            claims = {**state.claims, event.subject.action_id: (*state.claims.get(event.subject.action_id, ()), event)}
            return Authority(claims, state.rights, state.approvals)
        case AuthorityReleased():
            left = tuple(claim for claim in state.claims.get(event.subject.action_id, ()) if _key(claim) != _key(event))
            claims = {**state.claims, event.subject.action_id: left}
            if not left:
                del claims[event.subject.action_id]
            return Authority(claims, state.rights, state.approvals)
        case PolicyWindowOpened() | PolicyRuleSet() | RolePolicyRuleSet() | FleetRuleLearned():
            if not state.approvals:
                return state
            approvals = {action: _with(later, event) for action, later in state.approvals.items()}
            return Authority(state.claims, state.rights, approvals)
        case ExecutionFinished():
            if event.subject.action_id not in state.approvals:
                return state
            approvals = {
                action: later for action, later in state.approvals.items() if action != event.subject.action_id
            }
            return Authority(state.claims, state.rights, approvals)
        case AuthorityGranted() | AuthorityRevoked():
            return Authority(state.claims, (*state.rights, event), state.approvals)
        case SupervisorResponded():
            if event.purpose != "review" or not event.approves:
                return state
            return Authority(state.claims, state.rights, {**state.approvals, event.subject.action_id: Later()})
        case _:
            assert_never(event)


def _with(later: Later, event: PolicyWindowOpened | PolicyRuleSet | RolePolicyRuleSet | FleetRuleLearned) -> Later:
    """Return the policy that came after the approval, including this event's."""
    match event:
        case PolicyWindowOpened():
            return Later(later.windows | {event.window}, later.rules, later.heard)
        case PolicyRuleSet() | RolePolicyRuleSet():
            return Later(later.windows, later.rules | {key_of(event)}, later.heard)
        case FleetRuleLearned():
            return Later(later.windows, later.rules, {**later.heard, event.robot: event.outcome})
        case _:
            assert_never(event)


def _key(event: AuthorityClaimed | AuthorityReleased) -> tuple[str, str, str]:
    """Return the identity of the claim: a claimant may hold a dimension for two reasons and release only one."""
    return event.dimension, event.claimant, event.reason
