"""Typed events: the facts a ledger holds.

One file per concept, earlier versions in `retired.py`; imports msgspec only.
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

# See docs/decisions/verdicts-are-not-logged.md.
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
"""The changes that turn an event of each retired type into a current one, built and checked at import."""

ADDITIONS: Mapping[type[Event], Addition] = additions(RETIRED_TYPES, UPCASTERS)
"""The retired types that become current by adding fields alone, which SQL does in place."""

ALONE: frozenset[type[Event]] = frozenset({ExperimentPlanned})
"""The event types that are the only event of their run: they describe runs and happen in none.

Event 0 of any other run is `RunStarted`.
"""


def _concerns() -> dict[str, str]:
    """Return the concern of each event type by name. Raises: TypeError if a type's file is not named after one."""
    found: dict[str, str | None] = {kind.__name__: kind.__module__.rpartition(".")[2] for kind in EVENT_TYPES}
    found |= BESIDE
    if stray := sorted(name for name, concern in found.items() if concern not in (None, *CONCERNS)):
        raise TypeError(
            f"{', '.join(stray)}: found in a file not named after a concern, expected one of {', '.join(CONCERNS)}; "
            "move it, or name its concern in fsar_ledger/events/concerns.py"
        )
    return {name: concern for name, concern in found.items() if concern is not None}


CONCERN_OF: dict[str, str] = _concerns()
"""The concern of each event type, by name without version.

A type that describes the run itself has none: every run has it, whatever it observes.
"""

__all__ = ["ADDITIONS", "ALONE", "CONCERN_OF", "EVENT_TYPES", "RETIRED_TYPES", "UPCASTS", "AnyEvent", "Event"]
