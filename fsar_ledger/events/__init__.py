"""Typed events: the facts a ledger holds.

One file per concept, versions of the past in `retired.py`; imports msgspec only.
"""

from collections.abc import Mapping
from typing import get_args

from .authority import AuthorityEvent
from .command import CommandEvent
from .concerns import BESIDE, CONCERNS
from .envelope import Event
from .execution import ExecutionEvent
from .experiment import ExperimentEvent, ExperimentPlanned
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
from .upcasting import Addition, Chains, additions, chains
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
"""How an event of each retired type becomes a current one; made, and thereby checked, when the package starts."""

ADDITIONS: Mapping[type[Event], Addition] = additions(RETIRED_TYPES, UPCASTERS)
"""The retired types whose events become current ones by adding fields alone, so that SQL does it in place."""

ALONE: frozenset[type[Event]] = frozenset({ExperimentPlanned})
"""The types of events that are alone in their run: they are about runs, and happen in none.

Event 0 of any other run is `RunStarted`.
"""


def _concerns() -> dict[str, str]:
    """Return the concern of each event type by name. Raises: TypeError where a type's file is named after none."""
    found: dict[str, str | None] = {kind.__name__: kind.__module__.rpartition(".")[2] for kind in EVENT_TYPES}
    found |= BESIDE
    if stray := sorted(name for name, concern in found.items() if concern not in (None, *CONCERNS)):
        raise TypeError(
            f"{', '.join(stray)}: found in a file that is no concern, expected one of {', '.join(CONCERNS)}; "
            "move it, or name its concern in fsar_ledger/events/concerns.py"
        )
    return {name: concern for name, concern in found.items() if concern is not None}


CONCERN_OF: dict[str, str] = _concerns()
"""The concern of each event type, by its name whatever its version.

A type that says what a run is has none: it is there whatever a run observes.
"""

__all__ = ["ADDITIONS", "ALONE", "CONCERN_OF", "EVENT_TYPES", "RETIRED_TYPES", "UPCASTS", "AnyEvent", "Event"]
