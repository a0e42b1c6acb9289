"""Who holds which dimension of authority over which action. Paper: eq:auth."""

from typing import assert_never

import msgspec

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityGranted, AuthorityReleased, AuthorityRevoked

HANDLES = AuthorityClaimed | AuthorityReleased | AuthorityGranted | AuthorityRevoked


class Authority(msgspec.Struct, frozen=True, gc=False):
    """`claims`: action -> open claims; `rights`: who may, and who may no longer ask for what, in order."""

    claims: dict[str, tuple[AuthorityClaimed, ...]] = {}
    rights: tuple[AuthorityGranted | AuthorityRevoked, ...] = ()


INITIAL = Authority()


def evolve(state: Authority, event: HANDLES) -> Authority:
    """The claims and rights after the event."""
    match event:
        case AuthorityClaimed():
            return Authority({**state.claims, event.action_id: (*state.claims.get(event.action_id, ()), event)}, state.rights)
        case AuthorityReleased():
            left = tuple(claim for claim in state.claims[event.action_id] if _key(claim) != _key(event))
            claims = {**state.claims, event.action_id: left}
            if not left:
                del claims[event.action_id]
            return Authority(claims, state.rights)
        case AuthorityGranted() | AuthorityRevoked():
            return Authority(state.claims, (*state.rights, event))
        case _:
            assert_never(event)


def _key(event: AuthorityClaimed | AuthorityReleased) -> tuple[str, str, str]:
    """A claimant may hold the same dimension for two reasons, and let go of one."""
    return event.dimension, event.claimant, event.reason
