"""Typed events: the facts a ledger holds. One file per concept; imports msgspec only."""

from typing import get_args

from .authority import AuthorityEvent
from .envelope import Event
from .execution import ExecutionEvent
from .fleet import FleetEvent
from .knowledge import KnowledgeEvent
from .recovery import RecoveryEvent
from .registry import RegistryEvent
from .request import RequestEvent
from .supervision import SupervisionEvent
from .task import TaskEvent
from .trust import TrustEvent
from .world import WorldEvent

AnyEvent = (
    FleetEvent
    | RegistryEvent
    | TrustEvent
    | WorldEvent
    | TaskEvent
    | RequestEvent
    | AuthorityEvent
    | ExecutionEvent
    | RecoveryEvent
    | SupervisionEvent
    | KnowledgeEvent
)

EVENT_TYPES: tuple[type[Event], ...] = get_args(AnyEvent)

__all__ = ["EVENT_TYPES", "AnyEvent", "Event"]
