"""An architecture is a wiring: which handler decides a command, which reactions follow an event. It holds no state."""

from types import ModuleType

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.runtime.handlers.commands import Command, Decide, Decides, React


class Wiring(msgspec.Struct, frozen=True, eq=False):
    """Handlers by command type (exactly one each) and reactions by event type (in order)."""

    decides: dict[type[Command], Decide]
    reacts: dict[type[Event], tuple[React, ...]]


def wire(*handlers: ModuleType, own: Decides | None = None) -> Wiring:
    """The wiring of the handler modules' `DECIDES` and `REACTS`; `own` are commands of shared modules that the architecture decides in its own way.

    Raises:
        ValueError: two modules decide the same command.
    """
    decides: dict[type[Command], Decide] = {}
    reacts: dict[type[Event], tuple[React, ...]] = {}
    for module in handlers:
        for command, decide in module.DECIDES.items():
            if command in decides:
                raise ValueError(f"{module.__name__}: {command.__name__} is decided twice")
            decides[command] = decide
        for event, react in module.REACTS.items():
            reacts[event] = (*reacts.get(event, ()), react)
    return Wiring(decides | (own or {}), reacts)
