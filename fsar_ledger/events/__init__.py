"""Typed events: the facts a ledger holds. One file per concept; imports msgspec only."""

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
from .supervision import SupervisionEvent
from .task import TaskEvent
from .trust import TrustEvent
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

__all__ = ["EVENT_TYPES", "AnyEvent", "Event"]
