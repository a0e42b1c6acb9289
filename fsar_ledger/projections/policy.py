"""Policy that was set by rule. Paper: eq:policy, app:foundations."""

from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope
from fsar_ledger.events.policy import PolicyRuleSet

from .world import stricter

HANDLES = PolicyRuleSet

Rule = tuple[PolicyScope, str | None, str | None, str | None]  # scope, robot, capability, context; None: all of them
Policy = dict[Rule, PolicyOutcome]

INITIAL: Policy = {}


def ruled(state: Policy, scope: PolicyScope, robot: str, capability: str | None, context: str | None) -> PolicyOutcome | None:
    """The strictest rule of this scope that applies, or None when nothing is ruled."""
    outcome: PolicyOutcome | None = None
    for (of, about, what, where), found in state.items():
        if of == scope and about in (None, robot) and what in (None, capability) and where in (None, context):
            outcome = found if outcome is None else stricter(outcome, found)
    return outcome


def evolve(state: Policy, event: HANDLES) -> Policy:
    """The rules after the event."""
    return {**state, (event.scope, event.robot, event.capability, event.context): event.outcome}
