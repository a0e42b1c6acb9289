"""The state of a run from outside in the ledger: how far it is, and how far an import came, from the run alone."""

from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import InvalidRun, UsageError
from fsar_ledger.base.printable import counted, value
from fsar_ledger.events import Event
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.locations import event_count, place_of
from fsar_ledger.ledger.store.manifest import parse_manifest, read_manifest
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.store.read import View

from .adapter import UNREADABLE
from .columns import Declared

NewEvent = tuple[int, int | None, Event]
"""The run time of an event, the seq of its cause, and the event."""
BYTES = "bytes"
"""The name of an unreadable record's length, by which a line that was not whole yet is recognised."""


class StoredRun(msgspec.Struct, frozen=True):
    """A run as the ledger holds it: its beginning, how many events it has, and the time of the last.

    `robots` are the roles of those that joined before the first source was `opened`, `supervisors` their supervisors.
    """

    started: RunStarted
    size: int
    last_us: int
    robots: dict[str, str]
    supervisors: dict[str, str | None]
    opened: "Opening | None"


def stored_run(path: Path, run: str) -> StoredRun | None:
    """Return the run as the ledger holds it, None if it does not.

    Raises: LedgerCorrupted; UsageError if the run of this name was not begun by a recorder or an import.
    """
    view = open_ledger(path)
    if not view.has_run(run):
        return None
    parts = view.parts(run)
    row = msgspec.json.decode(view.event(place_of(view, run, 0)), type=dict[str, object])
    if row["type"] != RunStarted.__struct_config__.tag or row.get("kind") != "foreign":
        raise UsageError(
            f"run {value(run)}: found a run that was not recorded from outside, expected a new name or one that was"
        )
    fields = {name: row[name] for name in ("type", *RunStarted.__struct_fields__) if name in row}
    started = msgspec.convert(fields, RunStarted)
    robots, supervisors, opened = dict[str, str](), dict[str, str | None](), None
    for event, line in _rows(view, run):
        if event.type == "RobotJoined.v1":
            robots[f"{event.robot}"], supervisors[f"{event.robot}"] = f"{event.role}", event.supervisor
        elif event.seq:
            opened = msgspec.json.decode(line, type=Opening) if event.type == "SourceOpened.v1" else None
            break
    return StoredRun(started, event_count(parts), parts[-1].block.last_us, robots, supervisors, opened)


def kept_origin(path: Path) -> str | None:
    """Return the origin of the ledger at this path, None if there is none. Raises: NotALedger."""
    return parse_manifest(path / MANIFEST, read_manifest(path)).origin if (path / MANIFEST).exists() else None


def origin_of(path: Path, origin: str | None, signer: Signer | None, default: str) -> str:
    """Return this origin, or else that of the ledger at this path, or of a new one. Raises: NotALedger."""
    return origin or kept_origin(path) or (signer.verifier.name if signer is not None else default)


class _Row(msgspec.Struct):
    """The fields that are read of each event."""

    run_id: str
    type: str
    seq: int
    record_number: int | None = None
    robot: str | None = None
    role: str | None = None
    supervisor: str | None = None


class Opening(msgspec.Struct, frozen=True):
    """The fields of `SourceOpened` about the input and its reader."""

    adapter: str
    input_sha256: str | None = None
    mapping_sha256: str | None = None


class LastRecord(msgspec.Struct, frozen=True):
    """The last record of the input that is on file."""

    kind: str
    record_sha256: str | None = None
    names: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()

    def is_begun_by(self, raw: bytes) -> bool:
        """Return whether the record on file is the beginning of this one: its line was still being written."""
        length = dict(zip(self.names, self.texts, strict=False)).get(BYTES, "")
        if self.kind != UNREADABLE or not length.isdecimal() or int(length) >= len(raw):
            return False
        return sha256(raw[: int(length)]).hexdigest() == self.record_sha256


class EarlierImport(msgspec.Struct, frozen=True):
    """A run that was imported before: its events, its records, and how its source was opened.

    `first` is the number of the first event of a record; `beside` are the later events of no record, as where the
    import was continued. `last_seq` is the number of the event that holds the last record.
    """

    size: int
    last_us: int
    epoch_us: int | None
    declared: Declared
    first: int
    records: int = 0
    beside: set[int] = set()
    robots: dict[str, str] = {}
    last: LastRecord | None = None
    last_seq: int = 0
    opened: Opening | None = None
    is_closed: bool = False


def earlier_import(path: Path, run: str) -> EarlierImport | None:
    """Return the earlier import of the run, None if there is no run of that name.

    Raises: As `stored_run`.
    """
    stored = stored_run(path, run)
    if stored is None:
        return None
    first, last, records = stored.size, 0, 0
    beside, robots = set[int](), dict[str, str]()
    opening = record = b""
    row = None
    for row, line in _rows(open_ledger(path), run):
        match row.type:
            case "SourceOpened.v1" | "SourceClosed.v1":
                beside.add(row.seq)
                opening = line if row.type == "SourceOpened.v1" else opening
            case "Observed.v1":
                if records and row.record_number == records:
                    beside.add(last)  # the same line, before it was whole
                first, last, records, record = min(first, row.seq), row.seq, row.record_number or 0, line
            case "RobotJoined.v1" if not records:
                robots[f"{row.robot}"] = f"{row.role}"
    started = stored.started
    return EarlierImport(
        stored.size,
        stored.last_us,
        utc.read_us(started.epoch),
        Declared(started.observes, started.records or ()),
        first,
        records,
        beside,
        robots,
        msgspec.json.decode(record, type=LastRecord) if record else None,
        last,
        msgspec.json.decode(opening, type=Opening) if opening else None,
        row is not None and row.type == "SourceClosed.v1",
    )


def record_hashes(path: Path, run: str) -> Iterator[str]:
    """Yield the SHA-256 of each record of the run that is on file, in order; of one that was cut at first, when whole.

    Raises: LedgerCorrupted.
    """
    number, last = 0, ""
    for row, line in _rows(open_ledger(path), run):
        if row.type == "Observed.v1":
            if number and row.record_number != number:
                yield last
            number, last = row.record_number or 0, msgspec.json.decode(line, type=LastRecord).record_sha256 or "none"
    if number:
        yield last


def _rows(view: View, run: str) -> Iterator[tuple[_Row, bytes]]:
    decoder = msgspec.json.Decoder(_Row)
    for part in view.parts(run):
        for line in view.rows(part.first, part.end):
            row = decoder.decode(line)
            if row.run_id == run:
                yield row, line


def commit(writer: Writer, path: Path, run: str, rows: Sequence[NewEvent], first: int) -> None:
    """Commit these events of a run, the first of which has this seq, whole and durably.

    Raises: UsageError if the run does not end where they begin, since another process adds to it; as `Writer`.
    """
    times, causes, events = (list(column) for column in zip(*rows, strict=True))
    try:
        writer.commit([LedgerRun(run, times, causes, events, first, goes_on=True)])
    except InvalidRun as error:
        size = event_count(open_ledger(path).parts(run))
        if size == first:
            raise
        raise UsageError(
            f"run {value(run)}: found {counted(size, 'event')} on file, expected {first:,}; another process adds to "
            "this run: let one end before the other begins"
        ) from error
