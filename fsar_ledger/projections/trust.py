"""Trust scopes between robots, explicit, scope-aware and queryable. Paper: eq:trust."""

from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import TrustScope
from fsar_ledger.events.trust import TrustSet, TrustThresholdsSet

HANDLES = TrustSet | TrustThresholdsSet

SCOPES: tuple[TrustScope, ...] = ("none", "capability", "task", "session", "persistent")  # from narrow to broad
About = tuple[str | None, str | None]  # capability, context; None: all of them


class Trust(msgspec.Struct, frozen=True, gc=False):
    """`entries`: (robot, peer) -> what about -> scope; `promote_after`, `downgrade_after`: results in a row, 0 is never."""

    entries: dict[tuple[str, str], dict[About, TrustScope]] = {}
    promote_after: int = 0
    downgrade_after: int = 0


INITIAL = Trust()


def scope_of(state: Trust, robot: str, peer: str, capability: str | None = None, context: str | None = None) -> TrustScope:
    """How far the robot trusts the peer; the most specific entry holds, and without any there is none."""
    entries = state.entries.get((robot, peer))
    if entries is None:
        return "none"
    for about in ((capability, context), (capability, None), (None, context)):
        if about in entries:
            return entries[about]
    return entries.get((None, None), "none")


def covers(scope: TrustScope, required: TrustScope) -> bool:
    """True when the scope is at least as broad as the required one; `none` covers nothing."""
    return scope != "none" and SCOPES.index(scope) >= SCOPES.index(required)


def evolve(state: Trust, event: HANDLES) -> Trust:
    """Trust after the event."""
    match event:
        case TrustSet():
            pair = (event.robot, event.peer)
            entries = {**state.entries.get(pair, {}), (event.capability, event.context): event.scope}
            return msgspec.structs.replace(state, entries={**state.entries, pair: entries})
        case TrustThresholdsSet():
            return msgspec.structs.replace(state, promote_after=event.promote_after, downgrade_after=event.downgrade_after)
        case _:
            assert_never(event)
