"""The verb `record`, and the recorder of Python: a fleet of one's own on record as it happens."""

import sys
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText, counted

from .answers import Answer, Screen
from .names import Names, Place, names_of
from .verbs import KeyOption, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.sources.recorder import Fleet, Recorder

CONTINUES = "every event that was told is on disk, and the same command continues the run"


def record(
    out: Place,
    *,
    fleet: "Fleet" = (),
    observes: Names = None,
    run: str | None = None,
    source: str = "recorder",
    epoch: datetime | None = None,
    origin: str | None = None,
    key: Place | None = None,
    private_names: Place | None = None,
) -> "Recorder":
    """Return a recorder, which appends what happens to a run of the ledger OUT.

    Args:
        out: A new folder, or that of a ledger.
        fleet: The robots: role by name, or `RobotJoined` events.
        observes: What is recorded completely: concerns, event types and fields of them that may be unknown.
        run: The name of the run; one that is there goes on. None: the time at which it begins.
        source: Who records.
        epoch: The time of run time 0; None: now.
        origin: Publish a new ledger under this name.
        key: The file of the key that signs.
        private_names: A file outside the ledger that keeps the names of people, in whose place commitments are stored.

    Raises: As `Recorder`.
    """
    from fsar_ledger.ledger.store.keys import read_signer
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.sources.names import PrivateNames
    from fsar_ledger.sources.recorder import Recorder

    if private_names is not None:
        require_outside(Path(private_names), option("private_names", private_names))
    return Recorder(
        Path(out),
        fleet=fleet,
        observes=names_of(observes) or (),
        run=run,
        source=source,
        epoch=epoch,
        origin=origin,
        signer=None if key is None else read_signer(Path(key)),
        names=None if private_names is None else PrivateNames(Path(private_names)),
    )


class RecordResult(Answer, msgspec.Struct, frozen=True):
    """How many lines were recorded, and what was wrong with the others, by the number of the line."""

    ledger: Path
    run: str
    events: int
    refused: dict[int, str]

    @property
    def exit_code(self) -> int:
        """Return 1 if a line was refused."""
        return 1 if self.refused else 0

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return all of it."""
        refused = {str(line): why for line, why in self.refused.items()}
        return {"ledger": str(self.ledger), "run": self.run, "events": self.events, "refused": refused}

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield what was recorded, and the first lines that were not."""
        yield printable.lines(
            f"{self.ledger}: run {printable.value(self.run)}, {counted(self.events, 'event')} recorded, "
            f"{len(self.refused):,} refused",
            *(f"line {line}: {why}" for line, why in list(self.refused.items())[: printable.NAMED]),
        )


@verb(
    "record out/site --run night --observes ExecutionStarted    # reads standard input",
    name="record",
    takes=("json",),
    after_interruption=CONTINUES,
)
def record_lines(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to add to.")],
    *,
    run: str | None = declare("NAME", "The name of the run; one that is there goes on.", "the present time"),
    source: str = declare("NAME", "Who records.", value="recorder"),
    observes: Names = declare(
        "NAME",
        "What is recorded completely: a concern, an event type, or TYPE.FIELD; may be repeated.",
        "nothing: only observations (`Observed`) are taken",
    ),
    fleet: Place | None = declare("FILE", "A .toml file that names the robots: [robots], NAME = ROLE."),
    epoch: str | None = declare("TIME", "When the run begins, as 2026-03-01T10:00Z.", "now"),
    origin: str | None = declare("NAME", "Publish a new ledger under this name.", "the key's name, else a general one"),
    key: KeyOption = None,
    private_names: Place | None = declare(
        "FILE", "Store commitments in place of the names of people, which this file outside the ledger keeps."
    ),
) -> RecordResult:
    """Record events from standard input as they come, one JSON object a line, each on disk before the next is read.

    A line has `type` (`ExecutionStarted`) and the columns of that type (`docs/event-types.json`), and perhaps `time`
    (ISO 8601; UTC if it has no zone) and `caused_by`. A line that is wrong is refused, and the record goes on.

    Raises:
        UsageError: A name in --observes is none, or the run is there and was declared otherwise.
        WriteFailed: A write failed; what is committed stays.
    """
    from fsar_ledger.sources.adapter import named_robots
    from fsar_ledger.sources.columns import tell

    robots = named_robots(Path(fleet)) if fleet is not None else {}
    begins = None if epoch is None else _time(epoch)
    with record(
        out,
        fleet=robots,
        observes=observes,
        run=run,
        source=source,
        epoch=begins,
        origin=origin,
        key=key,
        private_names=private_names,
    ) as recorder:
        events, refused = tell(recorder, sys.stdin.buffer)
        return RecordResult(Path(out), recorder.run, events, refused)


def _time(text: str) -> datetime:
    try:
        return utc.parsed(text)
    except ValueError as error:
        found = printable.value(text)
        raise UsageError(f"{option('epoch')}: found {found}, expected a time such as 2026-03-01T10:00Z") from error
