"""Event types as they once were. Ledgers keep rows of them for ever, so they are never edited and never go; none is retired yet.

An event type that changes by more than a new optional field gets the next version: `class StepBegan(Event, frozen=True,
tag="StepBegan.v2")`. What it was moves here as `class StepBeganV1(Event, frozen=True, tag="StepBegan.v1")`, with an
upcaster to the next version. Rows stay stored, checked and hashed as they are; who reads events meets the newest version only.
"""

from typing import Any

from .envelope import Event
from .upcasting import Upcaster

RETIRED_TYPES: tuple[type[Event], ...] = ()
"""Every type that was current in a release and is so no more."""

UPCASTERS: tuple[Upcaster[Any, Any], ...] = ()
"""For each retired type the step to its next version."""
