"""Typed events: the facts a ledger holds. One file per concept, versions of the past in `retired.py`; imports msgspec only."""

from typing import get_args

from .authority import AuthorityEvent
from .command import CommandEvent
from .concerns import CONCERNS
from .envelope import Event
from .execution import ExecutionEvent
from .experiment import ExperimentEvent, ExperimentPlanned
from .fleet import FleetEvent, RunStarted
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
    | ExperimentEvent
)

EVENT_TYPES: tuple[type[Event], ...] = get_args(AnyEvent)

UPCASTS: Chains = chains(EVENT_TYPES, RETIRED_TYPES, UPCASTERS)
"""How an event of each retired type becomes one of today; made, and thereby checked, when the package starts."""

ALONE: frozenset[type[Event]] = frozenset({ExperimentPlanned})
"""The types of events that are the only one of their run: they are about runs, and happen in none. Event 0 of any other run is `RunStarted`."""

CONCERN_OF: dict[str, str] = {
    cls.__name__: concern for cls in EVENT_TYPES if (concern := cls.__module__.rpartition(".")[2]) in CONCERNS and cls is not RunStarted
}
"""The concern of each event type, by its name whatever its version: the file that it is in. `RunStarted` is there whatever a run observes."""

__all__ = ["ALONE", "CONCERN_OF", "EVENT_TYPES", "RETIRED_TYPES", "UPCASTS", "AnyEvent", "Event"]
