"""A run that is played by public commands: nothing happens in the world but what is given."""

from collections.abc import Iterable
from typing import Any

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.handlers.commands import Command, Scheduled
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from tests.runtime.histories import happen, started
from tests.sure import only


def decided(state: State, command: Command, table: HandlerTable = FSAR) -> tuple[Event, ...]:
    """What FSAR makes of the command, or the architecture of another table."""
    return table.decides[type(command)](state, command)


def refusal(events: tuple[Event, ...]) -> str:
    """Why the command was rejected."""
    one = only(CommandRejected, events)
    return one.reason


def play(state: State, *commands: Command, table: HandlerTable = FSAR) -> tuple[Any, ...]:
    """The events of the last command, all of them applied."""
    events: tuple[Any, ...] = ()
    for command in commands:
        events = decided(state, command, table)
        happen(state, *events)
    return events


def played(commands: Iterable[tuple[int, Command]], *before: Event, facts: Iterable[tuple[int, Event]] = ()) -> Kernel:
    """The whole run: a fleet of four, these events at its founding, and the commands at their times (microseconds)."""
    constants = Constants()
    one = Kernel(
        FSAR,
        SimulatedEnvironment(
            sorted(facts, key=lambda fact: fact[0]), Draws(run_key(1, "door-relay", 0), constants.world)
        ),
        (*started("fsar"), *before),
    )
    for serial, (time_us, command) in enumerate(commands):
        one._pending.put((time_us, serial - 1_000, 0, Scheduled(command)))
    one.run()
    return one


def when(run: Kernel, kind: type[Event], **fields: object) -> list[int]:
    """The times of the events of this kind with these fields."""
    pairs = zip(run.times_us, run.events, strict=True)
    return [time_us for time_us, event in pairs if isinstance(event, kind) and flat(event).items() >= fields.items()]


def of(run: Kernel | LedgerRun, *kinds: type[Event]) -> list[tuple[int, Any]]:
    """The events of these kinds with their times."""
    return [
        (time_us, event) for time_us, event in zip(run.times_us, run.events, strict=True) if isinstance(event, kinds)
    ]
