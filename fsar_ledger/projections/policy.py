"""Policy set by rule. Paper: eq:policy, app:foundations."""

from collections.abc import Container, Iterator, Mapping
from functools import cached_property
from typing import NamedTuple, assert_never

import msgspec

from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, Robot
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet

from . import put
from .trust import Member, around
from .world import stricter

HANDLES = RobotJoined | PolicyRuleSet | RolePolicyRuleSet

Rule = tuple[PolicyScope, Robot | None, str | None, str | None]  # scope, robot, capability, context; None: all of them
RoleRule = tuple[PolicyScope, str, str, str | None, str | None]  # scope, role, domain, capability, context


class Policy(msgspec.Struct, frozen=True, dict=True):
    """The rules in force: for single robots or every robot (`rules`), and for roles (`of_roles`).

    `members`: robot -> its role and domain.
    """

    rules: Mapping[Rule, PolicyOutcome] = {}
    of_roles: Mapping[RoleRule, PolicyOutcome] = {}
    members: Mapping[Robot, Member] = {}

    @cached_property
    def named_robots(self) -> frozenset[Robot]:
        """The robots for which there is a rule by name."""
        return frozenset(robot for _, robot, _, _ in self.rules if robot is not None)

    @property
    def is_empty(self) -> bool:
        """Return whether there are no rules."""
        return not self.rules and not self.of_roles


INITIAL = Policy()


def ruled(
    state: Policy,
    scope: PolicyScope,
    robot: Robot,
    capability: str | None,
    context: str | None,
    among: Container[Rule | RoleRule] | None = None,
) -> PolicyOutcome | None:
    """Return the outcome of the strictest rule of this scope that applies, or None if none does. Reading: R36.

    `among`: only these rules count. For the same capability and context, the robot's own rule replaces those of its
    role, and the rule of a smaller domain those of larger ones; a rule for every robot applies in addition.
    """
    outcome: PolicyOutcome | None = None
    for about in ((capability, context), (capability, None), (None, context), (None, None)):
        for rule, rule_outcome in _about(state, scope, robot, *about):
            if among is None or rule in among:
                outcome = rule_outcome if outcome is None else stricter(outcome, rule_outcome)
    return outcome


def standing(
    state: Policy, scope: PolicyScope, robot: Robot, capability: str | None, context: str | None
) -> PolicyOutcome:
    """Return the outcome of the strictest rule of this scope that applies; `allow` if none does."""
    return "allow" if state.is_empty else ruled(state, scope, robot, capability, context) or "allow"


def _about(
    state: Policy, scope: PolicyScope, robot: Robot, capability: str | None, context: str | None
) -> Iterator[tuple[Rule | RoleRule, PolicyOutcome]]:
    """Yield the rules about exactly this capability and context that hold for the robot."""
    of_all: Rule = (scope, None, capability, context)
    if of_all in state.rules:
        yield of_all, state.rules[of_all]
    # See docs/decisions/trust-and-rules-are-by-role.md.
    of_robot: Rule = (scope, robot, capability, context)
    if of_robot in state.rules:
        yield of_robot, state.rules[of_robot]
    elif state.of_roles and robot in state.members:
        role, domain = state.members[robot]
        of_role: Iterator[RoleRule] = ((scope, role, name, capability, context) for name in around(domain))
        nearest = next((rule for rule in of_role if rule in state.of_roles), None)
        if nearest is not None:
            yield nearest, state.of_roles[nearest]


class RuleInForce(NamedTuple):
    """A rule that holds for a robot; `capability`, `context` None: all of them."""

    robot: Robot
    scope: PolicyScope
    capability: str | None
    context: str | None
    outcome: PolicyOutcome


def rules_in_force(state: Policy) -> Iterator[RuleInForce]:
    """Yield each rule with each robot for which it holds, without those that another one replaces."""
    about = dict.fromkeys(
        (
            *((scope, capability, context) for scope, _, capability, context in state.rules),
            *((scope, capability, context) for scope, _, _, capability, context in state.of_roles),
        )
    )
    for robot in dict.fromkeys((*state.members, *sorted(state.named_robots))):
        for scope, capability, context in about:
            for _, outcome in _about(state, scope, robot, capability, context):
                yield RuleInForce(robot, scope, capability, context, outcome)


def evolve(state: Policy, event: HANDLES) -> Policy:
    """Return the rules after the event."""
    match event:
        case RobotJoined():
            return Policy(state.rules, state.of_roles, put(state.members, event.robot, (event.role, event.domain)))
        case PolicyRuleSet() | RolePolicyRuleSet():
            rule = key_of(event)
            if len(rule) == 4:
                return Policy(put(state.rules, rule, event.outcome), state.of_roles, state.members)
            return Policy(state.rules, put(state.of_roles, rule, event.outcome), state.members)
        case _:
            assert_never(event)


def key_of(event: PolicyRuleSet | RolePolicyRuleSet) -> Rule | RoleRule:
    """Return the key of the rule; a later rule with the same key replaces it."""
    if isinstance(event, PolicyRuleSet):
        return event.scope, event.robot, event.capability, event.context
    return event.scope, event.role, event.domain, event.capability, event.context
