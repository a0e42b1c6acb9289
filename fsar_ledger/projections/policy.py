"""Policy that was set by rule. Paper: eq:policy, app:foundations."""

from collections.abc import Container
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet

from .trust import Member, around
from .world import stricter

HANDLES = RobotJoined | PolicyRuleSet | RolePolicyRuleSet

Rule = tuple[PolicyScope, str | None, str | None, str | None]  # scope, robot, capability, context; None: all of them
RoleRule = tuple[PolicyScope, str, str, str | None, str | None]  # scope, role, domain, capability, context


class Policy(msgspec.Struct, frozen=True, gc=False):
    """`rules`: those of single robots, and of every robot; `of_roles`: those of roles; `members`: robot -> its role and domain."""

    rules: dict[Rule, PolicyOutcome] = {}
    of_roles: dict[RoleRule, PolicyOutcome] = {}
    members: dict[str, Member] = {}

    @property
    def is_empty(self) -> bool:
        """True while nothing is ruled."""
        return not self.rules and not self.of_roles


INITIAL = Policy()


def ruled(
    state: Policy, scope: PolicyScope, robot: str, capability: str | None, context: str | None, among: Container[Rule | RoleRule] | None = None
) -> PolicyOutcome | None:
    """The strictest rule of this scope that applies, of all or of those `among` them, or None when nothing is ruled.

    About the same capability and context the rule of the very robot replaces those of its role, and of these that of the smallest domain
    the others; a rule of every robot applies beside them.
    """
    outcome: PolicyOutcome | None = None
    for rule, found in _applying(state, scope, robot, capability, context).items():
        if among is None or rule in among:
            outcome = found if outcome is None else stricter(outcome, found)
    return outcome


def _applying(state: Policy, scope: PolicyScope, robot: str, capability: str | None, context: str | None) -> dict[Rule | RoleRule, PolicyOutcome]:
    """The rules that apply, those left out that another replaces."""
    applying: dict[Rule | RoleRule, PolicyOutcome] = {
        rule: outcome
        for rule, outcome in state.rules.items()
        if rule[0] == scope and rule[1] in (None, robot) and rule[2] in (None, capability) and rule[3] in (None, context)
    }
    if not state.of_roles or robot not in state.members:
        return applying
    role, domain = state.members[robot]
    for what, where in ((capability, context), (capability, None), (None, context), (None, None)):
        if (scope, robot, what, where) in state.rules:
            continue
        of_role = ((scope, role, one, what, where) for one in around(domain))
        nearest = next((rule for rule in of_role if rule in state.of_roles), None)
        if nearest is not None:
            applying[nearest] = state.of_roles[nearest]
    return applying


def evolve(state: Policy, event: HANDLES) -> Policy:
    """The rules after the event."""
    match event:
        case RobotJoined():
            return Policy(state.rules, state.of_roles, {**state.members, event.robot: (event.role, event.domain)})
        case PolicyRuleSet() | RolePolicyRuleSet():
            rule = key_of(event)
            if len(rule) == 4:
                return Policy({**state.rules, rule: event.outcome}, state.of_roles, state.members)
            return Policy(state.rules, {**state.of_roles, rule: event.outcome}, state.members)
        case _:
            assert_never(event)


def key_of(event: PolicyRuleSet | RolePolicyRuleSet) -> Rule | RoleRule:
    """What the rule is about; a later one about the same replaces it."""
    if isinstance(event, PolicyRuleSet):
        return event.scope, event.robot, event.capability, event.context
    return event.scope, event.role, event.domain, event.capability, event.context
