"""Retired versions of event types. Ledgers keep rows of them for ever, so they are never edited or removed.

An event type that changes by more than a new optional field gets the next version: `class StepBegan(Event, frozen=True,
tag="StepBegan.v2")`. The old struct moves here as `class StepBeganV1(Event, frozen=True, tag="StepBegan.v1")`, with an
upcaster to the next version: `adding` if that only has more fields, which SQL does in place for any number of rows,
else a function from event to event. Rows stay stored, checked and hashed as they are; readers of events see only the
newest version.
"""

from typing import Any, Literal

from .envelope import Event
from .fleet import RunStarted
from .upcasting import Upcaster, adding


# See docs/decisions/evidence-is-never-rewritten.md.
class RunStartedV1(Event, frozen=True, tag="RunStarted.v1"):
    """`RunStarted` until 0.2.0: a run of our own, simulated or live, that observes everything without saying so."""

    kind: Literal["simulated", "live"]
    seed: int
    architecture: Literal["fsar", "cfc", "dhma"]
    configuration: Literal[
        "full",
        "without-trust-evaluation",
        "without-policy-composition",
        "without-layered-recovery",
        "without-shared-registry",
    ]
    scenario: Literal[
        "door-relay",
        "collaborative-delivery",
        "failure-recovery-chain",
        "mixed-trust-inspection",
        "fleet-contention",
        "workflow-door-relay",
        "workflow-layered-recovery",
        "workflow-human-supervision",
        "live",
    ]
    fleet_size: int
    run: int
    model_version: str
    parameters: str


# The concerns of 0.2.0, listed because one that a later release adds was not observed then. Both kinds of run were made
# by our own handlers, which record everything that they decide, are told and encounter.
_OBSERVED_BY_V1 = (
    "fleet",
    "registry",
    "trust",
    "policy",
    "task",
    "request",
    "authority",
    "execution",
    "recovery",
    "supervision",
    "knowledge",
    "message",
    "command",
    "world",
)


RETIRED_TYPES: tuple[type[Event], ...] = (RunStartedV1,)
"""Every type that was current in a release and no longer is."""

UPCASTERS: tuple[Upcaster[Any, Any], ...] = (adding(RunStartedV1, RunStarted, observes=_OBSERVED_BY_V1),)
"""The step from each retired type to its next version."""
