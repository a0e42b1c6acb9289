"""Who holds which dimension of authority over which action. Paper: eq:auth."""

from typing import assert_never

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased

HANDLES = AuthorityClaimed | AuthorityReleased

Authority = dict[str, tuple[AuthorityClaimed, ...]]  # action -> open claims

INITIAL: Authority = {}


def evolve(state: Authority, event: HANDLES) -> Authority:
    """The open claims after the event."""
    match event:
        case AuthorityClaimed():
            return {**state, event.action_id: (*state.get(event.action_id, ()), event)}
        case AuthorityReleased():
            left = tuple(claim for claim in state[event.action_id] if _key(claim) != _key(event))
            changed = {**state, event.action_id: left}
            if not left:
                del changed[event.action_id]
            return changed
        case _:
            assert_never(event)


def _key(event: AuthorityClaimed | AuthorityReleased) -> tuple[str, str, str]:
    """A claimant may hold the same dimension for two reasons, and let go of one."""
    return event.dimension, event.claimant, event.reason
