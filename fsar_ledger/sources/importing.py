"""Files of a source go into a run of a ledger: each record once, however often the import was interrupted.

Records and what is derived from them are committed together, in the order of the input. What the ledger holds of a run
says how far it came: an import that is called again reads the input from its beginning, to know again what it knew, and
goes on after the last record on file.
"""

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import escaped, value
from fsar_ledger.base.progress import Progress
from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.events.source import Observed, SourceClosed, SourceOpened
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.view import Part

from .adapter import Adapter, Derived, Input, Record
from .declared import Declared, declared
from .recorder import kept_origin, stored_run

ORIGIN = "fsar-ledger/imported"
COMMIT_EVENTS = 4_096
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Misunderstood(msgspec.Struct, frozen=True):
    """A kind of record of which the adapter makes nothing: how many there are, and the number of the first."""

    kind: str
    count: int
    first: int


class Imported(msgspec.Struct, frozen=True):
    """What became of the input: how many records it has, how many were there before, and what was made of the others.

    `events` counts the derived events by type, `robots` are those that the records name.
    """

    run: str
    format: str
    records: int
    before: int
    events: dict[str, int]
    not_understood: tuple[Misunderstood, ...]
    declared: Declared
    robots: tuple[str, ...]


class _Held(msgspec.Struct, frozen=True):
    """How far the run on file came: its events, where the first record is, and the last record of the input."""

    size: int
    first_record: int
    last_us: int
    epoch_us: int | None
    records: int
    record_sha256: str | None
    opened: SourceOpened | None
    is_closed: bool


def import_files(
    path: Path,
    inputs: Sequence[Input],
    adapter: Adapter,
    *,
    run: str,
    fleet: Mapping[str, str] | None = None,
    mapping_sha256: str | None = None,
    keeps_bodies: bool = False,
    origin: str | None = None,
    signer: Signer | None = None,
    progress: Progress | None = None,
) -> Imported:
    """Import these inputs into a run of the ledger at this path, which is made if there is none.

    With a `fleet` (role by name of a robot) its robots join, and a robot that acts without being of it offends I1;
    without one nothing is said of who belongs to the fleet. With `keeps_bodies` each record is kept whole, in
    hexadecimal if it is no text.

    Raises:
        UsageError: The input is on file already, or another one is under this name; or as `Adapter.read`.
        NotALedger, LedgerCorrupted, WriteFailed: As `Writer`; what is committed stays, and the import goes on there.
    """
    name = origin or (signer.verifier.name if signer is not None else ORIGIN)
    names = [*adapter.declares(), *(["RobotJoined"] if fleet is not None else [])]
    with Writer(path, kept_origin(path) or name, signer) as writer:
        one = _Import(writer, path, adapter, run, declared(names), keeps_bodies)
        digest = _digest(inputs)
        one.resume(digest)
        one.opened = SourceOpened(
            source=adapter.name,
            format=adapter.format,
            adapter=f"{adapter.name}/{adapter.version}",
            clock=adapter.clock,
            is_sampled=adapter.is_sampled,
            input_sha256=digest,
            mapping_sha256=mapping_sha256,
        )
        one.fleet = fleet or {}
        one.read(inputs, progress)
        return one.result()


class _Import:
    """An import on its way: what is to be committed next, and what the adapter has said so far."""

    def __init__(
        self, writer: Writer, path: Path, adapter: Adapter, run: str, says: Declared, keeps_bodies: bool
    ) -> None:
        self.writer, self.path, self.adapter, self.run = writer, path, adapter, run
        self.declared, self.keeps_bodies = says, keeps_bodies
        self.held: _Held | None = None
        self.opened: SourceOpened | None = None
        self.fleet: Mapping[str, str] = {}
        self.seq, self.last_us, self.count = 0, 0, 0
        self.epoch_us: int | None = None
        self.rows: list[tuple[int, int | None, Event]] = []
        self.first = 0
        self.keys: dict[str, int] = {}
        self.made = Counter[str]()
        self.missed: dict[str, tuple[int, int]] = {}
        self.robots: dict[str, None] = {}
        self.is_new = False

    def resume(self, digest: str | None) -> None:
        """Look at what the ledger holds of the run. Raises: UsageError if the same input is on file whole."""
        self.held = _held(self.path, self.run)
        if self.held is None:
            return
        opened = self.held.opened
        if opened is None or opened.adapter.partition("/")[0] != self.adapter.name:
            raise UsageError(
                f"run {value(self.run)}: found a run of {value(opened.adapter if opened else 'a recorder')}, expected "
                f"one that was imported as {self.adapter.name}; give the import another name (--run)"
            )
        if self.held.is_closed and digest is not None and opened.input_sha256 == digest:
            raise UsageError(
                f"run {value(self.run)}: found the same input (SHA-256 {digest[:16]}...), with {self.held.records:,} "
                "records, expected one that is not on file; it is all there"
            )
        self.epoch_us, self.seq = self.held.epoch_us, self.held.first_record

    def read(self, inputs: Sequence[Input], progress: Progress | None) -> None:
        """Read every record, commit those that are not on file, and close the source."""
        held = self.held.records if self.held is not None else 0
        is_live = any(one.path is None for one in inputs)
        for record in self.adapter.read(inputs):
            self.count += 1
            if self.epoch_us is None:
                self.epoch_us = self._when_us(record)
            if self.count == held + 1:
                self._begin()
            derived = self.adapter.derive(record)
            if derived is None:
                number, first = self.missed.get(record.kind, (0, self.count))
                self.missed[record.kind] = (number + 1, first)
            self._add(record, derived or ())
            if self.count == held:
                self._require_same(record)
            if len(self.rows) >= COMMIT_EVENTS or is_live:
                self._commit()
                if progress is not None:
                    progress(self.count, 0)
        if self.count < held:
            raise UsageError(
                f"run {value(self.run)}: found {self.count:,} records in the input, expected the {held:,} on file and "
                "more; it is not the input that was imported, or it was cut short"
            )
        if self.count == held:
            self._begin()
        closed = SourceClosed(source=self.adapter.name, until_us=self.last_us, record_count=self.count)
        self._put(self.last_us, None, closed)
        self._commit()

    def result(self) -> Imported:
        """Return what became of the input."""
        missed = sorted(self.missed.items(), key=lambda one: (-one[1][0], one[0]))
        return Imported(
            self.run,
            self.adapter.format,
            self.count,
            self.held.records if self.held is not None else 0,
            dict(sorted(self.made.items())),
            tuple(Misunderstood(kind, count, first) for kind, (count, first) in missed),
            self.declared,
            tuple(self.robots),
        )

    def _begin(self) -> None:
        """Begin the run, or go on with it behind what is on file."""
        assert self.opened is not None
        self.is_new = True
        opened = msgspec.structs.replace(self.opened, format=self.adapter.format)
        if self.held is not None:
            if self.seq + self.held.is_closed != self.held.size:
                self.keys.clear()  # it was continued before, so the numbers of what came later are others
            self.seq, self.last_us = self.held.size, max(self.last_us, self.held.last_us)
            self._put(self.last_us, None, opened)
            return
        epoch = None if self.epoch_us is None else (EPOCH + timedelta(microseconds=self.epoch_us)).isoformat()
        started = RunStarted(
            kind="foreign",
            observes=self.declared.observes,
            records=self.declared.records,
            epoch=epoch and epoch.replace("+00:00", "Z"),
            source=self.adapter.name,
        )
        self._put(0, None, started)
        for robot, role in self.fleet.items():
            name = robot if robot.startswith("robot/") else f"robot/{robot}"
            self._put(0, 0, RobotJoined(robot=Robot(name), role=role, supervisor=None))
        self._put(0, 0, opened)

    def _add(self, record: Record, derived: Iterable[Derived]) -> None:
        """Add a record, and what follows from it."""
        when_us = self._when_us(record)
        if when_us is not None and self.epoch_us is not None:
            self.last_us = max(self.last_us, when_us - self.epoch_us)
        at = self._put(self.last_us, None, self._observed(record))
        for one in derived:
            kind = type(one.event).__name__
            if kind in CONCERN_OF and kind not in self.declared.kinds:
                raise UsageError(
                    f"record {self.count}: found {kind}, expected an event that {self.adapter.name} declares; mend the "
                    "adapter"
                )
            cause = at if one.cause is None else self.keys.get(one.cause, at)
            seq = self._put(self.last_us, cause, one.event)
            if one.key is not None:
                self.keys[one.key] = seq
            self.made[kind] += 1
            if (robot := getattr(one.event, "robot", None)) is not None:
                self.robots[robot] = None

    def _observed(self, record: Record) -> Observed:
        source_us = None if record.source_us is None or self.epoch_us is None else record.source_us - self.epoch_us
        return Observed(
            source=self.adapter.name,
            kind=escaped(record.kind),
            names=tuple(map(escaped, record.values)),
            texts=tuple(map(escaped, record.values.values())),
            objects=tuple(map(escaped, record.objects)),
            qualifiers=tuple(map(escaped, record.objects.values())),
            source_time_us=source_us,
            record_number=self.count,
            record_sha256=hashlib.sha256(record.raw).hexdigest(),
            body=_text(record.raw) if self.keeps_bodies else None,
        )

    def _when_us(self, record: Record) -> int | None:
        if self.adapter.clock == "source":
            return record.source_us if record.source_us is not None else record.arrival_us
        return record.arrival_us if record.arrival_us is not None else record.source_us

    def _put(self, time_us: int, caused_by: int | None, event: Event) -> int:
        """Add an event to the next commit, unless it is on file; return its number within the run."""
        if self.is_new:
            if not self.rows:
                self.first = self.seq
            self.rows.append((time_us, caused_by, event))
        self.seq += 1
        return self.seq - 1

    def _require_same(self, record: Record) -> None:
        assert self.held is not None
        found = hashlib.sha256(record.raw).hexdigest()
        if found != self.held.record_sha256:
            raise UsageError(
                f"run {value(self.run)}: found another record {self.count:,} in the input (SHA-256 {found[:16]}...) "
                f"than on file ({(self.held.record_sha256 or 'none')[:16]}...), expected the input that was imported, "
                "perhaps with more at its end; give another input another name (--run)"
            )

    def _commit(self) -> None:
        if not self.rows:
            return
        times, causes, events = (list(column) for column in zip(*self.rows, strict=True))
        self.writer.add([LedgerRun(self.run, times, causes, events, self.first, goes_on=True)])
        self.rows = []


def _held(path: Path, run: str) -> _Held | None:
    """Return how far the run on file came, None if there is none."""
    stored = stored_run(path, run)
    if stored is None:
        return None
    opened, first, records, sha256, is_closed = None, stored.size, 0, None, False
    for row in _beginning_and_end(path, run):
        match row["type"]:
            case "SourceOpened.v1":
                opened = msgspec.convert(
                    {name: row[name] for name in ("type", *SourceOpened.__struct_fields__) if name in row}, SourceOpened
                )
            case "Observed.v1":
                first, records, sha256 = min(first, row["seq"]), row["record_number"], row["record_sha256"]
        is_closed = row["type"] == "SourceClosed.v1"
    epoch = stored.started.epoch
    epoch_us = None if epoch is None else (datetime.fromisoformat(epoch) - EPOCH) // timedelta(microseconds=1)
    return _Held(stored.size, first, stored.last_us, epoch_us, records, sha256, opened, is_closed)


def _beginning_and_end(path: Path, run: str) -> Iterator[dict[str, Any]]:
    """Yield the events of the run up to its first record, and those from the last commit that has one."""
    view = open_ledger(path)
    parts = view.parts(run)

    def rows(part: Part) -> list[dict[str, Any]]:
        found = [msgspec.json.decode(line, type=dict[str, Any]) for line in view.rows(part.first, part.end)]
        return [row for row in found if row["run_id"] == run]

    ends: list[list[dict[str, Any]]] = []
    for part in reversed(parts):
        ends.append(rows(part))
        if any(row["type"] == "Observed.v1" for row in ends[-1]):
            break
    for part in parts[: len(parts) - len(ends)]:
        begins = rows(part)
        yield from begins
        if any(row["type"] == "Observed.v1" for row in begins):
            break
    for end in reversed(ends):
        yield from end


def _digest(inputs: Sequence[Input]) -> str | None:
    """Return the SHA-256 of the files one after the other; None where one is no file."""
    if any(one.path is None for one in inputs):
        return None
    digest = hashlib.sha256()
    for one in inputs:
        for block in _blocks(one):
            digest.update(block)
        one.file.seek(0)
    return digest.hexdigest()


def _blocks(one: Input) -> Iterator[bytes]:
    while block := one.file.read(1 << 20):
        yield block


def _text(raw: bytes) -> str:
    try:
        return escaped(raw.decode())
    except UnicodeDecodeError:
        return raw.hex()
