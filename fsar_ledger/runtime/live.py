"""A live run: a fleet that is really there, under the handlers of FSAR.

Robots and people give commands (`handlers/public.py`, `architectures/fsar/reports.py`), each on record as
`CommandGiven`. Nothing else comes from outside but the time, so the commands alone make the run again.
"""

from collections.abc import Mapping
from typing import Any

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.runs import LedgerRun

from .architectures.fsar.reports import commands, given, read
from .kernel import Kernel
from .ports import LiveEnvironment
from .simulation import MODEL_VERSION, constants_text, fleet_founding, handler_table_of

ARCHITECTURE = "fsar"
"""Whose handlers govern a live run: those of the others speak for their robots."""
SOURCE = "fsar-ledger"
AT_ONCE_US = 1_000
"""What follows from a command within this time has followed when it is answered, a step that begins, for one."""


class Decision(msgspec.Struct, frozen=True):
    """What became of a command: the number of its record within the run, its events, and why it was rejected.

    `events` are those that it led to itself; `followed` what happened at once after them, as a request that a step
    makes. Of a command that was given before only `events` are told again.
    """

    seq: int
    events: tuple[Event, ...]
    rejected: str | None = None
    followed: tuple[Event, ...] = ()


def live_started(constants: Constants, robots: int, epoch: str | None = None) -> RunStarted:
    """Return event 0 of a live run of a fleet of so many robots."""
    return RunStarted(
        kind="live",
        observes=CONCERNS,
        architecture=ARCHITECTURE,
        configuration="full",
        fleet_size=robots,
        model_version=MODEL_VERSION,
        parameters=constants_text(constants),
        source=SOURCE,
        epoch=epoch,
    )


# See docs/decisions/live-runs-are-their-commands.md.
class LiveRun:
    """A live run in progress. Times are run time, in microseconds, and never go back."""

    def __init__(self, started: RunStarted, constants: Constants, record: LedgerRun | None = None) -> None:
        """Begin the run, or make it again from the commands on its record, until the last of its events."""
        events, founded = fleet_founding(started.fleet_size or 0, constants)
        environment = LiveEnvironment(() if record is None else commands_of(record))
        self.kernel = Kernel(handler_table_of(ARCHITECTURE), environment, (started, *events), founded)
        if record is not None:
            self.kernel.run(record.times_us[-1])

    def give(self, time_us: int, command: CommandGiven) -> Decision:
        """Record the command and decide it, with what follows at once; no time is before the last event's."""
        kernel = self.kernel
        seq = kernel.happen(time_us, command)
        kernel.run(kernel.times_us[-1] + AT_ONCE_US)
        first = seq + 1 - kernel.first
        pairs = list(zip(kernel.events[first:], kernel.caused_by[first:], strict=True))
        decision = _decided(seq, [event for event, cause in pairs if cause == seq])
        followed = tuple(event for event, cause in pairs if cause != seq)
        return msgspec.structs.replace(decision, followed=followed)

    def advance(self, time_us: int) -> None:
        """Decide all that is due by then, such as a budget that has run out."""
        self.kernel.run(time_us)

    def take(self, run_id: str) -> LedgerRun:
        """Take out the events since the last call, to be recorded under this name; the run goes on."""
        return msgspec.structs.replace(self.kernel.take(), run_id=run_id, goes_on=True)


def commands_of(record: LedgerRun) -> tuple[tuple[int, CommandGiven], ...]:
    """Return the commands on record, each with its time."""
    pairs = zip(record.times_us, record.events, strict=True)
    return tuple((time_us, event) for time_us, event in pairs if isinstance(event, CommandGiven))


def decisions_by_key(record: LedgerRun) -> dict[tuple[str, str], Decision]:
    """Return what became of each command that has a key, by who gave it and that key."""
    keyed = {seq: one for seq, one in enumerate(record.events) if isinstance(one, CommandGiven) and one.key is not None}
    events: dict[int, list[Event]] = {seq: [] for seq in keyed}
    for event, cause in zip(record.events, record.caused_by, strict=True):
        if cause in events:
            events[cause].append(event)
    return {(f"{one.issued_by}", f"{one.key}"): _decided(seq, events[seq]) for seq, one in keyed.items()}


def _decided(seq: int, events: list[Event]) -> Decision:
    rejected = next((event.reason for event in events if isinstance(event, CommandRejected)), None)
    return Decision(seq, tuple(events), rejected)


def command_given(
    name: str, by: str, fields: Mapping[str, Any], key: str | None = None, sent_us: int | None = None
) -> CommandGiven:
    """Return the record of a command. Raises: UsageError, which names the field, for what is none."""
    kind = commands().get(name)
    if kind is None:
        raise UsageError(
            f"command {value(name)}: there is no such command{did_you_mean(name, commands()) or ';'} expected one of "
            f"{', '.join(sorted(commands()))}"
        )
    try:
        found = given(read(kind, msgspec.json.encode(fields).decode()), by, key=key, source_time_us=sent_us)
    except (msgspec.ValidationError, TypeError) as error:
        raise UsageError(f"command {name}: {error!s:.300}") from error
    for text in (by, key or "", *(one for one in fields.values() if isinstance(one, str))):
        if not text.isprintable():
            raise UsageError(f"command {name}: found {text!r:.80}, expected characters that can be printed")
    return found
