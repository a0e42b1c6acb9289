"""Typed events: the facts a ledger holds. One file per concept, versions of the past in `retired.py`; imports msgspec only."""

from typing import get_args

from .authority import AuthorityEvent
from .command import CommandEvent
from .envelope import Event
from .execution import ExecutionEvent
from .fleet import FleetEvent
from .knowledge import KnowledgeEvent
from .policy import PolicyEvent
from .recovery import RecoveryEvent
from .registry import RegistryEvent
from .request import RequestEvent
from .retired import RETIRED_TYPES, UPCASTERS
from .supervision import SupervisionEvent
from .task import TaskEvent
from .trust import TrustEvent
from .upcasting import Chains, chains
from .world import WorldEvent

AnyEvent = (
    FleetEvent
    | RegistryEvent
    | TrustEvent
    | PolicyEvent
    | WorldEvent
    | TaskEvent
    | RequestEvent
    | AuthorityEvent
    | ExecutionEvent
    | RecoveryEvent
    | SupervisionEvent
    | KnowledgeEvent
    | CommandEvent
)

EVENT_TYPES: tuple[type[Event], ...] = get_args(AnyEvent)

UPCASTS: Chains = chains(EVENT_TYPES, RETIRED_TYPES, UPCASTERS)
"""How an event of each retired type becomes one of today; made, and thereby checked, when the package starts."""

__all__ = ["EVENT_TYPES", "RETIRED_TYPES", "UPCASTS", "AnyEvent", "Event"]
