"""Which policy holds for an action, and what several of them make together. Paper: eq:policy, app:foundations."""

from fsar_ledger.events.envelope import PolicyOutcome
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import ruled
from fsar_ledger.projections.world import in_force, stricter


def own_policy(state: State, robot: str, capability: str | None, context: str | None) -> PolicyOutcome:
    """P_i(e, sigma): the strictest of the robot's open windows and of its rules. Paper: app:foundations."""
    return stricter(in_force(state.world.local, robot), ruled(state.policy, "local", robot, capability, context) or "allow")


def fleet_policy(state: State, robot: str, capability: str | None, context: str | None) -> PolicyOutcome:
    """The fleet's rules for the robot, and that for its zone as it last heard it; without policy composition nobody asks."""
    if state.fleet.configuration == "without-policy-composition":
        return "allow"
    heard = state.knowledge.fleet_rule.get(robot, "allow")
    return stricter(heard, ruled(state.policy, "fleet", robot, capability, context) or "allow")


def compose(state: State, carried: PolicyOutcome, executor: str, capability: str, context: str | None) -> PolicyOutcome:
    """Pi: requester's policy (as the request carried it), the executor's own and the fleet's together. Paper: eq:policy."""
    own = own_policy(state, executor, capability, context)
    if state.fleet.configuration == "without-policy-composition":
        return own
    return stricter(carried, stricter(own, fleet_policy(state, executor, capability, context)))
