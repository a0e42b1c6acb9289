"""Typed events: the facts a ledger holds.

One file per concept; imports msgspec only. Earlier versions are in `retired.py`, for readers of stored rows.
"""

from collections.abc import Mapping
from types import ModuleType

from . import (
    authority,
    command,
    execution,
    fleet,
    knowledge,
    policy,
    recovery,
    registry,
    request,
    source,
    supervision,
    task,
    trust,
    world,
)
from .envelope import Event as Event

_MODULES = (
    fleet,
    registry,
    trust,
    policy,
    world,
    task,
    request,
    authority,
    execution,
    recovery,
    supervision,
    knowledge,
    command,
    source,
)


def _types_in(module: ModuleType) -> list[type[Event]]:
    """Return the event types that the module defines, in its order."""
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, Event)]
    return [kind for kind in kinds if kind.__module__ == module.__name__]


ALONE: frozenset[type[Event]] = frozenset({fleet.ExperimentPlanned, fleet.ShardRecorded})
"""The event types that are the only event of their run: they describe runs and happen in none.

Event 0 of any other run is `RunStarted`.
"""

# See docs/decisions/verdicts-are-not-logged.md.
EVENT_TYPES: tuple[type[Event], ...] = tuple(
    sorted((kind for module in _MODULES for kind in _types_in(module)), key=ALONE.__contains__)
)
"""Every event type that a concern's file defines; plans and heads of shards come last."""

# See docs/decisions/unobserved-is-null.md.
CONCERNS: tuple[str, ...] = (
    "fleet",  # robots and their membership
    "registry",  # capabilities, advertisements, availability, look-ups
    "trust",
    "policy",  # rules and windows, a robot's own and the fleet's
    "task",
    "request",  # requests between robots, from the gap to the end, and how they are decided
    "authority",  # claims, grants, revocations
    "execution",  # who does what, and routine
    "recovery",  # failures and what is done about them
    "supervision",  # supervisors: calls, answers, absences
    "knowledge",  # what a decider has been told
    "message",  # what the agents of one robot tell each other
    "command",  # commands from outside: given to a live run, and rejected
    "world",  # what happens to robots: obstructions, wear, outages, encounters, injected attempts
)
"""Every concern, in the order in which runs store them. Runs of our own handlers observe all of them."""

BESIDE: Mapping[str, str | None] = {
    "RunStarted": None,
    "RunContinued": None,
    "ExperimentPlanned": None,
    "ShardRecorded": None,
    "SourceOpened": None,
    "Observed": None,
    "SourceClosed": None,
    "TaskArrived": "task",
    "PolicyWindowOpened": "policy",
    "PolicyWindowClosed": "policy",
    "SupervisorLeft": "supervision",
    "SupervisorReturned": "supervision",
    "ExecutionFailed": "recovery",
    "InternalHandoff": "message",
    "RoutineReported": "message",
}
"""The types, in any version, whose concern is not their file's, and those of which every version is retired.

None: the type describes the run itself and belongs to no concern.
"""


def _concerns() -> dict[str, str]:
    """Return the concern of each event type by name. Raises: TypeError if a type's file is not named after one."""
    concerns: dict[str, str | None] = {kind.__name__: kind.__module__.rpartition(".")[2] for kind in EVENT_TYPES}
    concerns |= BESIDE
    if stray := sorted(name for name, concern in concerns.items() if concern not in (None, *CONCERNS)):
        raise TypeError(
            f"{', '.join(stray)}: found in a file not named after a concern, expected one of {', '.join(CONCERNS)}; "
            "move it, or name its concern in BESIDE, fsar_ledger/events/__init__.py"
        )
    return {name: concern for name, concern in concerns.items() if concern is not None}


CONCERN_OF: dict[str, str] = _concerns()
"""The concern of each event type, by name without version.

A type that describes the run itself has none: every run has it, whatever it observes.
"""
