"""Imports files of a source into a run of a ledger: each record once, however often the import was interrupted.

Records and what is derived from them are committed together, in the order of the input. The run in the ledger shows how
far the import came: when called again, it reads the input from the beginning, to rebuild its state, and continues after
the last record on file.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import counted, value
from fsar_ledger.base.progress import Progress
from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.events.envelope import recorded_robot
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.events.source import Observed, SourceClosed, SourceOpened
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.rows.schema import MAX_INTEGER
from fsar_ledger.ledger.store.append import Writer

from .adapter import LOOKED_AT, UNREADABLE, Adapter, Derived, Input, Record, awaited, digest_of, no_record
from .columns import Declared, declared, require_full_names, storable, storable_text, text_of
from .recorder import FORMAT, roles_of
from .stored import BYTES, EarlierImport, NewEvent, commit, earlier_import, origin_of, record_hashes

ORIGIN = "fsar-ledger/imported"
COMMIT_EVENTS, COMMIT_BYTES = 4_096, 1 << 21
"""The numbers of events and of bytes of text at which a commit is made."""
FARTHEST_US = MAX_INTEGER // 2
"""Units: microseconds, before and after 1970; 142 years."""


class Misunderstood(msgspec.Struct, frozen=True):
    """A kind of record that the adapter does not understand: how many there are, and the number of the first."""

    kind: str
    count: int
    first: int


class Imported(msgspec.Struct, frozen=True):
    """The result of an import: how many records the input has, how many were on file before, and what was derived.

    `events` counts the derived events by type, `robots` are those that the records name. Of the records with events,
    `undated` have no time, and `late` have one before that of an earlier record, by `late_us` microseconds at most.
    """

    run: str
    format: str
    records: int
    before: int
    events: dict[str, int]
    not_understood: tuple[Misunderstood, ...]
    declared: Declared
    robots: tuple[str, ...]
    undated: int
    late: int
    late_us: int

    def about_times(self) -> Iterator[str]:
        """Yield how many records with events are recorded at another time than their own, a line for each reason."""
        if self.undated:
            yield f"without a time: {counted(self.undated, 'record')} with events, dated as the one before"
        if self.late:
            yield (
                f"earlier than a record before: {counted(self.late, 'record')} with events, by up to "
                f"{self.late_us / 1e6:,.3f} s, dated as that record; sort the input first, unless it is in order of "
                "arrival"
            )


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
    """Import these inputs into a run of the ledger at this path, which is created if missing.

    With a `fleet` (roles by robot name) its robots join, and a robot outside it that acts violates I1; without one,
    membership of the fleet is not recorded. With `keeps_bodies` each record is kept whole, in hexadecimal if it is
    not text.

    Raises:
        UsageError: The input is on file already, or another input has this name; or as `Adapter.read`.
        NotALedger, LedgerCorrupted, WriteFailed: As `Writer`; what is committed stays, and a new call continues there.
    """
    names = [*adapter.declares()]
    if fleet is not None:  # which does not say who supervises its robots
        names = [*(name for name in names if name != "RobotJoined.supervisor"), "RobotJoined"]
    with Writer(path, origin_of(path, origin, signer, ORIGIN), signer) as writer:
        importer = _Import(writer, path, adapter, run, declared(names), keeps_bodies)
        opened = SourceOpened(
            source=adapter.name,
            format=adapter.format,
            adapter=f"{adapter.name}/{adapter.version}",
            clock=adapter.clock,
            is_sampled=adapter.is_sampled,
            input_sha256=digest_of(inputs),
            mapping_sha256=mapping_sha256,
        )
        importer.resume(opened, fleet or {})
        importer.read(inputs, progress)
        return importer.result()


class _Import:
    """An import in progress: the events to commit next, and the results so far."""

    def __init__(
        self, writer: Writer, path: Path, adapter: Adapter, run: str, says: Declared, keeps_bodies: bool
    ) -> None:
        self.writer, self.path, self.adapter, self.run = writer, path, adapter, run
        self.declared, self.keeps_bodies = says, keeps_bodies
        self.kinds = says.kinds
        self.earlier: EarlierImport | None = None
        self.opened: SourceOpened | None = None
        self.robots_of_fleet: Mapping[str, str] = {}
        self.joined_by_fleet: set[str] = set()
        self.seq, self.last_us, self.count, self.bytes = 0, 0, 0, 0
        self.epoch_us: int | None = None
        self.rows: list[NewEvent] = []
        self.first = 0
        self.keys: dict[str, int] = {}
        self.made = Counter[str]()
        self.missed: dict[str, tuple[int, int]] = {}
        self.robots: dict[str, None] = {}
        self.undated = self.late = self.late_us = 0
        self.is_new = False

    def resume(self, opened: SourceOpened, fleet: Mapping[str, str]) -> None:
        """Read the run in the ledger, if there is one. Raises: UsageError if this import cannot continue it."""
        self.opened = opened
        self.robots_of_fleet = dict(roles_of(fleet))
        self.joined_by_fleet = set(self.robots_of_fleet)
        self.earlier = earlier = earlier_import(self.path, self.run)
        if earlier is None:
            return
        if earlier.opened is None or earlier.opened.adapter.startswith(FORMAT):
            raise self._refused(
                "a run into which events were recorded as they happened",
                "one that holds only imports; what is on record is kept: give the import another name (--run)",
            )
        if earlier.opened.adapter.partition("/")[0] != self.adapter.name:
            raise self._refused(
                f"a run of {value(earlier.opened.adapter)}",
                f"one that was imported as {self.adapter.name}; give the import another name (--run)",
            )
        digest = opened.input_sha256
        if earlier.is_closed and digest is not None and earlier.opened.input_sha256 == digest:
            raise self._refused(
                f"the same input (SHA-256 {digest[:16]}...), with {earlier.records:,} records",
                "one that is not yet on record; nothing is missing",
            )
        if earlier.opened.mapping_sha256 != opened.mapping_sha256:
            raise self._refused(
                f"a run that was imported with another mapping (SHA-256 {earlier.opened.mapping_sha256})",
                f"the same one ({opened.mapping_sha256}); give the import another name (--run)",
            )
        if self.robots_of_fleet and earlier.robots != self.robots_of_fleet:
            raise self._refused(
                f"a run with {len(earlier.robots):,} robots in its fleet, of other names or roles",
                "the fleet with which it began (--fleet); give the import another name (--run)",
            )
        self.declared, self.robots_of_fleet = earlier.declared, earlier.robots
        self.epoch_us, self.seq = earlier.epoch_us, earlier.first

    def read(self, inputs: Sequence[Input], progress: Progress | None) -> None:
        """Read every record, commit those that are not on file, and close the source."""
        on_file = self.earlier.records if self.earlier is not None else 0
        hashes = record_hashes(self.path, self.run) if on_file else iter(())
        for record in self.adapter.read([awaited(log, self._commit_before_wait) for log in inputs]):
            self.count += 1
            if self.count == on_file and self._is_whole_now(record):
                on_file -= 1
            if self.count <= on_file:
                self._require_same(record, next(hashes, "none"))
            if self.count == on_file + 1:
                self._begin()
            if self.epoch_us is None:
                self._set_epoch(self._when_us(record))
            derived = self.adapter.derive(record)
            if derived is None:
                number, first = self.missed.get(record.kind, (0, self.count))
                self.missed[record.kind] = (number + 1, first)
            self._add(record, derived or ())
            if len(self.rows) >= COMMIT_EVENTS or self.bytes >= COMMIT_BYTES:
                self._commit()
                if progress is not None:
                    progress(self.count, 0)
        if not self.count:
            raise no_record(inputs)
        if self.count < on_file:
            raise self._refused(
                f"{self.count:,} records in the input",
                f"at least the {on_file:,} on record; it is not the input that was imported, or it was cut short",
            )
        if self.count == on_file:
            self._begin()
        closed = SourceClosed(source=self.adapter.name, until_us=self.last_us, record_count=self.count)
        self._put(self.last_us, None, closed)
        self._commit()

    def _is_whole_now(self, record: Record) -> bool:
        assert self.earlier is not None
        if self.earlier.last is None or not self.earlier.last.is_begun_by(record.line or record.raw):
            return False
        self.earlier.beside.add(self.earlier.last_seq)
        return True

    def result(self) -> Imported:
        """Return the result of the import."""
        missed = sorted(self.missed.items(), key=lambda item: (-item[1][0], item[0]))
        return Imported(
            self.run,
            self.adapter.format,
            self.count,
            self.earlier.records if self.earlier is not None else 0,
            dict(sorted(self.made.items())),
            tuple(Misunderstood(kind, count, first) for kind, (count, first) in missed),
            self.declared,
            tuple(self.robots),
            self.undated,
            self.late,
            self.late_us,
        )

    def _begin(self) -> None:
        """Begin the run, or continue it after what is on file."""
        assert self.opened is not None
        self.is_new = True
        opened = msgspec.structs.replace(self.opened, format=self.adapter.format)
        if self.earlier is not None:
            self._pass_beside()
            if self.seq != self.earlier.size:
                self.keys.clear()  # this adapter derives other events from the records on file, so their numbers differ
            self.seq, self.last_us = self.earlier.size, max(self.last_us, self.earlier.last_us)
            self._put(self.last_us, None, opened)
            return
        started = RunStarted(
            kind="foreign",
            observes=self.declared.observes,
            records=self.declared.records,
            epoch=None,
            source=self.adapter.name,
        )
        self._put(0, None, started)
        for robot, role in self.robots_of_fleet.items():
            self._put(0, 0, RobotJoined(robot=recorded_robot(robot), role=role, supervisor=None))
        self._put(0, 0, opened)

    def _set_epoch(self, when_us: int | None) -> None:
        """Take the first time of the input as run time 0, and record it if the beginning is not committed yet."""
        self.epoch_us = when_us
        if when_us is not None and self.rows and isinstance(started := self.rows[0][2], RunStarted):
            self.rows[0] = (0, None, msgspec.structs.replace(started, epoch=utc.shown_us(when_us)))

    def _add(self, record: Record, derived: Iterable[Derived]) -> None:
        """Add a record and the events that follow from it."""
        when_us, late_us = self._when_us(record), 0
        if when_us is not None and self.epoch_us is not None:
            late_us = self.last_us - (when_us - self.epoch_us)
            self.last_us -= min(late_us, 0)
        is_made = False
        record_seq = self._put(self.last_us, None, self._observed(record) if self.is_new else None)
        for item in derived:
            kind = type(item.event).__name__
            if kind in CONCERN_OF and kind not in self.declared.kinds:
                if kind in self.kinds:  # the run was begun by an adapter that did not declare it
                    continue
                raise UsageError(
                    f"record {self.count}: found {kind}, expected an event that {self.adapter.name} declares; correct "
                    "the adapter"
                )
            if isinstance(item.event, RobotJoined) and item.event.robot in self.joined_by_fleet:
                self.joined_by_fleet.remove(item.event.robot)  # the fleet's file names it
                continue
            try:
                require_full_names(item.event, self.robots_of_fleet)
            except UsageError as error:
                raise UsageError(f"record {self.count}: {error}; correct the mapping, or the fleet") from error
            cause = record_seq if item.cause is None else self.keys.get(item.cause, record_seq)
            event = storable(item.event)
            seq = self._put(self.last_us, cause, event)
            if item.key is not None:
                self.keys[item.key] = seq
            self.made[kind] += 1
            is_made = True
            if (robot := getattr(event, "robot", None)) is not None:
                self.robots[robot] = None
        if is_made:
            self.undated += when_us is None
            self.late += late_us > 0
            self.late_us = max(self.late_us, late_us)

    def _observed(self, record: Record) -> Observed:
        record_us = _storable_time_us(record.source_us)
        source_us = None if record_us is None or self.epoch_us is None else record_us - self.epoch_us
        values, objects = record.values, record.objects
        if record.kind == UNREADABLE:
            values = {**values, BYTES: f"{len(record.raw)}"}
        columns = tuple(values), tuple(values.values()), tuple(objects), tuple(objects.values())
        texts = "".join(chain(*columns))
        if not texts.isprintable():
            names, contents, subjects, parts = (tuple(map(storable_text, column)) for column in columns)
        else:
            names, contents, subjects, parts = columns
        body = text_of(record.raw) if self.keeps_bodies else None
        self.bytes += len(texts) + len(body or "")
        return Observed(
            source=self.adapter.name,
            kind=storable_text(record.kind),
            names=names,
            texts=contents,
            objects=subjects,
            qualifiers=parts,
            source_time_us=source_us,
            record_number=self.count,
            record_sha256=sha256_hex(record.raw),
            body=body,
        )

    def _when_us(self, record: Record) -> int | None:
        first, second = record.arrival_us, record.source_us
        if self.adapter.clock == "source":
            first, second = second, first
        first_us = _storable_time_us(first)
        return first_us if first_us is not None else _storable_time_us(second)

    def _put(self, time_us: int, caused_by: int | None, event: Event | None) -> int:
        """Add an event to the next commit, unless it is on file; return its number within the run."""
        if event is not None and self.is_new:
            if not self.rows:
                self.first = self.seq
            self.rows.append((time_us, caused_by, event))
        else:
            self._pass_beside()
        self.seq += 1
        return self.seq - 1

    def _pass_beside(self) -> None:
        while self.earlier is not None and self.seq in self.earlier.beside:
            self.seq += 1

    def _refused(self, found: str, expected: str) -> UsageError:
        return UsageError(f"run {value(self.run)}: found {found}, expected {expected}")

    def _require_same(self, record: Record, known: str) -> None:
        if (found := sha256_hex(record.raw)) != known:
            raise self._refused(
                f"another record {self.count:,} in the input (SHA-256 {found[:16]}...) than before ({known[:16]}...)",
                "the input that was imported, perhaps with more at its end; give another input another name (--run)",
            )

    def _commit_before_wait(self) -> None:
        """Commit what a stream has given; its beginning, which names the epoch, waits for a time, but not for long."""
        is_beginning = self.rows and isinstance(self.rows[0][2], RunStarted)
        if not is_beginning or self.epoch_us is not None or self.count >= LOOKED_AT:
            self._commit()

    def _commit(self) -> None:
        if self.rows:
            commit(self.writer, self.path, self.run, self.rows, self.first)
            self.rows, self.bytes = [], 0


def _storable_time_us(time_us: int | None) -> int | None:
    """Return the time; None if it is so far from 1970 that a run could not hold its distance from another."""
    return time_us if time_us is not None and abs(time_us) <= FARTHEST_US else None
