"""A knockout, and the ways in which it changes a handler table."""

from collections.abc import Callable, Mapping
from functools import lru_cache, wraps
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.constants import Structure
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import MECHANISMS_OF, Configuration, without
from fsar_ledger.events.envelope import Architecture, Robot, with_columns
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers.commands import Command, Decide

ChangeTable = Callable[[HandlerTable], HandlerTable]


class Knockout(NamedTuple):
    """One mechanism: its name, its architecture, and the decisions without it.

    `decides` replaces whole decisions; `change` alters the handler table in another way. A mechanism that the handlers
    check themselves has neither.
    """

    name: str
    architecture: Architecture
    decides: Mapping[type[Command], Decide] = MappingProxyType({})
    change: ChangeTable | None = None

    @property
    def mechanism(self) -> str:
        """Return what the mechanism does, and what replaces it."""
        return MECHANISMS_OF[self.architecture][self.name]

    @property
    def configuration(self) -> Configuration:
        """Return the configuration that lacks this mechanism alone."""
        return without([self.name])

    def taken_out_of(self, table: HandlerTable) -> HandlerTable:
        """Return the table without the mechanism."""
        changed = table if self.change is None else self.change(table)
        return HandlerTable({**changed.decides, **self.decides}, changed.reacts, changed.actors)


def nothing(_state: State, _command: Command) -> tuple[Event, ...]:
    """Decide nothing."""
    return ()


def seeing(slot: str, seen: Callable[[State], Any], decide: Callable[..., Any]) -> Callable[..., Any]:
    """Return the same decision or reaction, made on a state that has `seen` in this slot."""

    @wraps(decide)
    def decide_on_it(state: State, *about: Any) -> Any:
        other = State.__new__(State)
        for name in State.__slots__:
            setattr(other, name, getattr(state, name))
        setattr(other, slot, seen(state))
        return decide(other, *about)

    return decide_on_it


def edit_events(change: Callable[[State, Event], Event | None], decide: Decide) -> Decide:
    """Return the same decision with each event changed, or left out where `change` returns None."""

    @wraps(decide)
    def edited(state: State, command: Command) -> tuple[Event, ...]:
        return tuple(changed for event in decide(state, command) if (changed := change(state, event)) is not None)

    return edited


def in_every_decision(change: Callable[[State, Event], Event | None]) -> ChangeTable:
    """Return the change of a table that edits the events of every decision."""

    def changed(table: HandlerTable) -> HandlerTable:
        decides = {command: edit_events(change, decide) for command, decide in table.decides.items()}
        return HandlerTable(decides, table.reacts, table.actors)

    return changed


def leaving_out(kind: type[Event], command: type[Command]) -> ChangeTable:
    """Return the change of a table that drops events of this type from the decision on this command."""

    def changed(table: HandlerTable) -> HandlerTable:
        edited = edit_events(lambda _state, event: None if isinstance(event, kind) else event, table.decides[command])
        return HandlerTable({**table.decides, command: edited}, table.reacts, table.actors)

    return changed


def decided_by(event: Event, robot: Robot | None) -> Event:
    """Return the event with this robot, or nobody, recorded as the decider."""
    return with_columns(event, decided_by=robot, path=() if robot is None else (robot,))


def in_no_time(name: str) -> Callable[[State], Any]:
    """Return a view of the fleet in which this duration of its structure is 0."""
    return lambda state: state.fleet.__replace__(structure=_zeroed(state.fleet.structure, name))


@lru_cache(maxsize=4)
def _zeroed(structure: Structure, name: str) -> Structure:
    return msgspec.structs.replace(structure, **{name: 0})
