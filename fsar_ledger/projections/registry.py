"""Which robot advertises which capability to whom. Paper: eq:adv, eq:advertise."""

from fsar_ledger.events.registry import CapabilityAdvertised

HANDLES = CapabilityAdvertised

# capability -> (robot, roles that may discover it; empty: all)
Registry = dict[str, tuple[tuple[str, tuple[str, ...]], ...]]

INITIAL: Registry = {}


def evolve(state: Registry, event: HANDLES) -> Registry:
    """The registry after the event."""
    offers = state.get(event.capability, ())
    return {**state, event.capability: (*offers, (event.robot, event.visible_to))}
