"""Trust scopes between robots, explicit and queryable. Paper: eq:trust."""

from fsar_ledger.events.envelope import TrustScope
from fsar_ledger.events.trust import TrustSet

HANDLES = TrustSet

Trust = dict[tuple[str, str], TrustScope]  # (robot, peer) -> scope; a missing pair is `none`

INITIAL: Trust = {}


def evolve(state: Trust, event: HANDLES) -> Trust:
    """Trust after the event."""
    return {**state, (event.robot, event.peer): event.scope}
