"""A live run: a fleet that is really there, under the handlers of FSAR.

Robots and people give commands (`handlers/public.py`, `architectures/fsar/reports.py`), each on record as
`CommandGiven`. Nothing else comes from outside but the time, so the commands alone make the run again.
"""

import msgspec

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.runs import LedgerRun

from .architectures.fsar.reports import given
from .handlers.public import PublicCommand
from .kernel import Kernel
from .ports import LiveEnvironment
from .simulation import MODEL_VERSION, constants_text, fleet_founding, handler_table_of

ARCHITECTURE = "fsar"
"""Whose handlers govern a live run: those of the others speak for their robots."""
SOURCE = "fsar-ledger"


def live_started(constants: Constants, fleet_size: int, epoch: str | None = None) -> RunStarted:
    """Return event 0 of a live run of this fleet."""
    return RunStarted(
        kind="live",
        observes=CONCERNS,
        architecture=ARCHITECTURE,
        configuration="full",
        fleet_size=fleet_size,
        model_version=MODEL_VERSION,
        parameters=constants_text(constants),
        source=SOURCE,
        epoch=epoch,
    )


class LiveRun:
    """A live run in progress. Times are run time, in microseconds, and never go back."""

    def __init__(self, started: RunStarted, constants: Constants) -> None:
        events, founded = fleet_founding(started.fleet_size or 0, constants)
        self.kernel = Kernel(handler_table_of(ARCHITECTURE), LiveEnvironment(), (started, *events), founded)

    def give(
        self,
        time_us: int,
        command: PublicCommand,
        issued_by: str,
        *,
        key: str | None = None,
        sent_us: int | None = None,
    ) -> CommandRejected | None:
        """Record the command and decide it; return why it was rejected, None where it was carried out.

        Args:
            time_us: When it came; a time that has passed is the next microsecond.
            command: What is asked.
            issued_by: Who gave it, as is known of them.
            key: The name by which they tell whether it is the same command again.
            sent_us: When they say that they gave it.
        """
        record: CommandGiven = given(command, issued_by, key=key, source_time_us=sent_us)
        seq = self.kernel.happen(time_us, record)
        first = seq + 1 - self.kernel.first
        self.kernel.run(self.kernel.times_us[-1] + 1)
        for event, cause in zip(self.kernel.events[first:], self.kernel.caused_by[first:], strict=True):
            if cause == seq and isinstance(event, CommandRejected):
                return event
        return None

    def advance(self, time_us: int) -> None:
        """Let all timers run out that are due by then."""
        self.kernel.run(time_us)

    def take(self, run_id: str) -> LedgerRun:
        """Take out the events since the last call, to be recorded under this name; the run goes on."""
        return msgspec.structs.replace(self.kernel.take(), run_id=run_id, goes_on=True)
