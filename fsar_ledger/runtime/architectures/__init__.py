"""Architectures are structure only: deterministic tables of pure handlers, without access to randomness.

A `HandlerTable` says which handler decides a command, and which reactions follow an event. Each architecture is a
folder here, with its table under its name in capitals, and one line in `events.configuration.ARCHITECTURES`. The
mechanisms that can be removed from it, if any, are listed under its name in `events.configuration.MECHANISMS_OF`.
"""

from types import ModuleType

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.runtime.handlers import (
    authority,
    execution,
    fleet,
    policy,
    public,
    recovery,
    registry,
    request,
    supervision,
    task,
    trust,
)
from fsar_ledger.runtime.handlers.commands import (
    Actor,
    Command,
    Decide,
    DecideRoutine,
    Handlers,
    React,
    StartAction,
    TakeTurn,
)
from fsar_ledger.runtime.handlers.public import PublicCommand

# See docs/decisions/architectures-have-folders.md.
COMMON = (task, execution, supervision, public)
"""Modules that every architecture shares: tasks (also abandoned ones), execution, supervision, public commands."""

EXPECTED: tuple[type[Command], ...] = (TakeTurn, StartAction, DecideRoutine)
"""Commands that the shared modules issue and each architecture decides in its own way."""

PUBLIC = (fleet, registry, request, authority, trust, policy, recovery)
"""Modules whose commands from outside need the registry, trust, policy and rights of FSAR."""


class HandlerTable(msgspec.Struct, frozen=True, eq=False):
    """Handlers by command type (exactly one each), reactions by event type (in order), and actors by command type.

    The actor of a command is the robot or service that carries it out. Only commands from outside have none.
    """

    decides: dict[type[Command], Decide]
    reacts: dict[type[Event], tuple[React, ...]]
    actors: dict[type[Command], Actor] = {}

    @classmethod
    def of(
        cls,
        *modules: ModuleType | Handlers,
        own: dict[type[Command], Decide] | None = None,
        instead: dict[React, React] | None = None,
    ) -> "HandlerTable":
        """Collect the `HANDLERS` of the modules; the module that defines the table passes its own `Handlers` directly.

        `own` are commands of shared modules that the architecture decides in its own way; `instead` maps shared
        reactions to the architecture's own.

        Raises:
            ValueError: two modules decide the same command, a command has no actor, or a handler to be replaced does
                not exist.
        """
        decides: dict[type[Command], Decide] = {}
        reacts: dict[type[Event], tuple[React, ...]] = {}
        actors: dict[type[Command], Actor] = {}
        replaced: set[React] = set()
        for module in modules:
            handlers: Handlers = module if isinstance(module, Handlers) else module.HANDLERS
            for command in handlers.decides.keys() & decides.keys():
                duplicate = handlers.decides[command]
                raise ValueError(f"{duplicate.__module__}.{duplicate.__name__}: {command.__name__} is decided twice")
            decides |= handlers.decides
            actors |= handlers.actors
            for event, react in handlers.reacts.items():
                reacts[event] = (*reacts.get(event, ()), (instead or {}).get(react, react))
                replaced.add(react)
        missing = [react.__name__ for react in instead or {} if react not in replaced]
        missing += [f"{command.__name__} by no module" for command in own or {} if command not in decides]
        missing += [
            f"{command.__name__} by nobody"
            for command in decides
            if not issubclass(command, PublicCommand) and command not in actors
        ]
        if execution in modules:
            missing += [f"{command.__name__} by no handler" for command in EXPECTED if command not in decides]
        if missing:
            raise ValueError(f"a handler table lacks what it names: {', '.join(missing)}")
        return cls(decides | (own or {}), reacts, actors)
