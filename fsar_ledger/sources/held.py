"""How far an import came: what the ledger holds of its run, read from the run alone."""

from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.ledger.opening import open_ledger

from .adapter import UNREADABLE
from .columns import Declared
from .recorder import stored_run

BYTES = "bytes"
"""Under this name an unreadable record says its length: a line that was not whole yet is known by it again."""


class _Row(msgspec.Struct):
    """What is read of each event."""

    run_id: str
    type: str
    seq: int
    record_number: int | None = None
    robot: str | None = None
    role: str | None = None


class Opening(msgspec.Struct, frozen=True):
    """What `SourceOpened` says of the input and its reader."""

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


class Held(msgspec.Struct, frozen=True):
    """A run that was imported before: its events, its records, and how its source was opened.

    `first` is the number of the first event that a record led to; `beside` are the later ones that none did, as where
    the import was continued. `last_seq` is the number of the event that holds the last record.
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


def held(path: Path, run: str) -> Held | None:
    """Return what the ledger holds of the run, None if there is none of that name.

    Raises: As `stored_run`.
    """
    stored = stored_run(path, run)
    if stored is None:
        return None
    first, last, records = stored.size, 0, 0
    beside, robots = set[int](), dict[str, str]()
    opening = record = b""
    row = None
    for row, line in _rows(path, run):
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
    epoch = None if started.epoch is None else utc.parsed(started.epoch) - utc.EPOCH
    return Held(
        stored.size,
        stored.last_us,
        None if epoch is None else epoch // utc.MICROSECOND,
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


def _rows(path: Path, run: str) -> Iterator[tuple[_Row, bytes]]:
    view, decoder = open_ledger(path), msgspec.json.Decoder(_Row)
    for part in view.parts(run):
        for line in view.rows(part.first, part.end):
            row = decoder.decode(line)
            if row.run_id == run:
                yield row, line
