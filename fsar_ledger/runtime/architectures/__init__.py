"""Architectures are structure only: deterministic tables of pure handlers, without access to randomness.

A `HandlerTable` says which handler decides a command, and which reactions follow an event. Each architecture is a
folder here, with its table under its name in capitals, and one line in `events.configuration.ARCHITECTURES`. What can
be taken out of it is listed under its name in `events.configuration.MECHANISMS_OF`, if anything can.
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
"""What every architecture has: tasks, bodies, supervisors, a door for commands, what becomes of a task given up."""

EXPECTED: tuple[type[Command], ...] = (TakeTurn, StartAction, DecideRoutine)
"""What the shared modules give, and each architecture decides in its own way."""

PUBLIC = (fleet, registry, request, authority, trust, policy, recovery)
"""Commands from outside that need the registry, trust, policy and rights of FSAR."""


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
        """Collect the `HANDLERS` of the modules; the module that makes the table gives its own ones as they are.

        `own` are commands of shared modules that the architecture decides in its own way; `instead` maps shared
        reactions to the architecture's own.

        Raises:
            ValueError: two modules decide the same command, nobody carries one out, or what is to be replaced is
                not there.
        """
        decides: dict[type[Command], Decide] = {}
        reacts: dict[type[Event], tuple[React, ...]] = {}
        actors: dict[type[Command], Actor] = {}
        replaced: set[React] = set()
        for module in modules:
            handlers: Handlers = module if isinstance(module, Handlers) else module.HANDLERS
            for command in handlers.decides.keys() & decides.keys():
                again = handlers.decides[command]
                raise ValueError(f"{again.__module__}.{again.__name__}: {command.__name__} is decided twice")
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
