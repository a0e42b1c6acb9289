"""Records a fleet of one's own as it happens: each event is on disk when the call returns.

A lock serialises the calls of several threads. An invalid event is refused before anything of it is written, and the
record goes on.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import RLock

from fsar_ledger.base import utc
from fsar_ledger.base.errors import FsarLedgerError, InvalidRun, UsageError, checked, option
from fsar_ledger.base.printable import counted, value
from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.events.envelope import flat, recorded_robot
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.events.source import Observed, SourceClosed, SourceOpened
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.rows.runs import LedgerRun, first_unfit, refusal
from fsar_ledger.ledger.store.append import Writer

from .columns import Declared, declared, event_of, require_kinds, require_names, require_outcome, storable_text
from .names import PrivateNames
from .stored import NewEvent, StoredRun, commit, origin_of, stored_run

ORIGIN = "fsar-ledger/recorded"
FORMAT = "fsar-ledger/1"
"""The format of a record without a file: the events themselves."""
WITH_COMMITMENTS = f"{FORMAT}, names of people as commitments"
"""The adapter of runs in which names of people are stored as commitments."""

Fleet = Mapping[str, str] | Iterable[RobotJoined]
"""The robots: roles by name, without supervisors and teams, or the events of their joining."""


class Recorder:
    """Appends events to one run of a ledger. Use it as a context manager, or call `close`.

    Args:
        path: The ledger; created if missing.
        fleet: The robots, by name (`carrier-1` is `robot/carrier-1`) with their role, or events of their joining. They
            join when the run begins; a run that goes on has its robots, and takes no others.
        observes: What is recorded completely: concerns (`task`), event types (`ExecutionStarted`) and fields of them
            that may be unknown (`ExecutionStarted.requested_by`). The absence of anything else means nothing.
        run: The name of the run; an existing one is continued. None: the time at which it begins.
        source: Who records, by a name.
        epoch: The time of run time 0; None: now, or that of the run that goes on.
        origin: The name under which a new ledger is published.
        signer: The key that signs.
        names: The table of the names that are stored as commitments.

    Raises:
        UsageError: A name in `observes` is unknown or claims more than the fleet says, or the run began otherwise.
        NotALedger, LedgerCorrupted, WriteFailed: As `Writer`.
    """

    @checked
    def __init__(
        self,
        path: Path,
        *,
        fleet: Fleet = (),
        observes: Iterable[str] = (),
        run: str | None = None,
        source: str = "recorder",
        epoch: datetime | None = None,
        origin: str | None = None,
        signer: Signer | None = None,
        opened: SourceOpened | None = None,
        names: PrivateNames | None = None,
    ):
        self._names = names
        fleet = fleet if isinstance(fleet, Mapping) else [*fleet]
        self.declared, self.source, self._lock = declared(observes), source, RLock()
        begins = utc.zoned(datetime.now(UTC) if epoch is None else _moment("epoch", epoch)).astimezone(UTC)
        self.run = run or begins.isoformat(timespec="seconds")
        self._path = path
        self._writer, self._is_open = Writer(path, origin_of(path, origin, signer, ORIGIN), signer), True
        self._batch: list[NewEvent] | None = None
        self._count = 0
        self._is_called = False
        self._is_live = epoch is None  # events without a time happen now, so the run ends now; else at its last event
        try:
            stored = stored_run(path, self.run)
            if stored is None:
                self._next, self._last_us, self._epoch = 0, 0, begins
                self._begin(fleet, opened)
            else:
                self._next, self._last_us, self._is_live = stored.size, stored.last_us, False
                self._epoch = self._continued(stored, dict(roles_of(fleet)), epoch and begins)
                self._require_same_supervisors(stored, fleet)
                self._put(self._last_us, None, opened or self._opening())
        except BaseException:
            self._writer.close()
            raise

    @checked
    def event(
        self, event: Event | str, *, at: datetime | None = None, caused_by: int | None = None, **columns: object
    ) -> int:
        """Record an event, and return its number within the run.

        Args:
            event: The event, or the name of its type, which is one that the run records.
            at: When it happened (UTC if it has no zone); None: now.
            caused_by: The number of the event that led to it; None: not known.
            columns: With the name of a type: its columns, as in `docs/event-types.json`. Leave out what is not known.

        Raises:
            InvalidRun: A field has a value that it cannot have, or the type is not one that the run records. Nothing
                was written; the record goes on.
            UsageError: There is no such type or column, or `at` is not a time, or is before the last event.
            WriteFailed: The disk refused.
        """
        if isinstance(event, str):
            event = event_of(event, columns)
        elif columns:
            raise UsageError(f"event: found {type(event).__name__} and columns of it, expected one or the other")
        with self._call():
            event = event if self._names is None else self._names.event(event)
            self._require_recordable(event)
            number = self._put(self._time_us(at), caused_by, event)
            self._is_live = at is None
            return number

    @checked
    def observed(
        self,
        kind: str,
        values: Mapping[str, object] | None = None,
        *,
        objects: Mapping[str, str] | None = None,
        source_time: datetime | None = None,
        body: str | None = None,
        at: datetime | None = None,
    ) -> int:
        """Record an observation, in the words of its source, and return its number within the run.

        Anything without a type of its own goes here: it is kept, shown, searched and proven, and nothing is concluded
        from it. Unprintable text is escaped.

        Args:
            kind: What the source calls it (`battery/low`).
            values: What it says, by name.
            objects: What it is about, by name, each with the part that it plays (`{"robot/A1": "robot"}`).
            source_time: The time that the source gives, whatever its clock is worth.
            body: The whole record, if it is to be kept.
            at: When it was seen; None: now.

        Raises: As `event`.
        """
        contents, about = values or {}, objects or {}
        observation = Observed(
            source=self.source,
            kind=storable_text(kind),
            names=tuple(map(storable_text, contents)),
            texts=tuple(storable_text(str(content)) for content in contents.values()),
            objects=tuple(map(storable_text, about)),
            qualifiers=tuple(map(storable_text, about.values())),
            source_time_us=None if source_time is None else self.run_time_us(_moment("source_time", source_time)),
            body=None if body is None else storable_text(body),
        )
        return self.event(observation, at=at)

    @contextmanager
    def batch(self) -> Iterator[None]:
        """Commit everything recorded within the block at once, at its end; nothing of it if the block raises."""
        with self._lock:
            if self._batch is not None:
                raise UsageError("batch: found a batch within a batch, expected one at a time")
            saved, self._batch = (self._next, self._last_us, self._count), []
            try:
                yield
                with self._call():
                    self._commit(self._batch)
            except BaseException:
                self._next, self._last_us, self._count = saved
                raise
            finally:
                self._batch = None

    @checked
    def run_time_us(self, when: datetime) -> int:
        """Return the run time of a moment; one without a zone is UTC. Units: microseconds."""
        return (utc.zoned(when) - self._epoch) // utc.MICROSECOND

    def close(self) -> None:
        """Record until when the source was observed, and close the ledger. A recorder of the same run continues it."""
        with self._call():
            if not self._is_open:
                return
            self._is_open = False
            try:
                until_us = self._time_us(None) if self._is_live else self._last_us
                closed = SourceClosed(source=self.source, until_us=until_us, record_count=self._count)
                self._put(until_us, None, closed)
            finally:
                self._writer.close()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, _kind: object, error: object, _trace: object) -> None:
        with nullcontext() if error is None else suppress(FsarLedgerError):  # the first error is raised
            self.close()

    @contextmanager
    def _call(self) -> Iterator[None]:
        """Let one call after the other write. Raises: UsageError for a call within a call of the same thread."""
        with self._lock:
            if self._is_called:
                raise UsageError(
                    "record: found a call within a call, as by the handler of a signal, expected one at a time; "
                    "nothing was written: let the handler set a flag, and record outside of it"
                )
            self._is_called = True
            try:
                yield
            finally:
                self._is_called = False

    def _begin(self, fleet: Fleet, opened: SourceOpened | None) -> None:
        joined: list[Event] = [*_members(fleet)]
        claims = {"fleet", "RobotJoined.supervisor"} & {*self.declared.observes, *self.declared.records}
        if claims and joined and isinstance(fleet, Mapping):
            raise UsageError(
                f"{option('observes', min(claims))}: found a fleet with only the roles of its robots, expected one "
                f"that says who supervises each: record RobotJoined for each instead of {option('fleet')}, or observe "
                "only the event types that are recorded completely"
            )
        if joined and "RobotJoined" not in self.declared.kinds:
            self.declared = declared((*self.declared.observes, *self.declared.records, "RobotJoined"))
        started = RunStarted(
            kind="foreign",
            observes=self.declared.observes,
            records=self.declared.records,
            epoch=utc.iso_text(self._epoch),
            source=self.source,
        )
        if self._names is not None:
            joined = [self._names.event(member) for member in joined]
        events: list[Event] = [started, *joined, opened or self._opening()]
        self._commit([(0, None if index == 0 else 0, event) for index, event in enumerate(events)])
        self._next = len(events)

    def _opening(self) -> SourceOpened:
        adapter = FORMAT if self._names is None else WITH_COMMITMENTS
        return SourceOpened(source=self.source, format=FORMAT, adapter=adapter, clock="arrival")

    def _continued(self, stored: StoredRun, robots: Mapping[str, str], epoch: datetime | None) -> datetime:
        """Check that the run was begun as this recorder would, and return its epoch."""
        started = stored.started
        kept = Declared(started.observes, started.records or ())
        requested = self.declared
        if self._names is None and stored.opened is not None and stored.opened.adapter == WITH_COMMITMENTS:
            raise UsageError(
                f"run {value(self.run)}: found a run with commitments in place of the names of people, expected their "
                f"table ({option('private_names')}); nothing was changed"
            )
        if self._names is not None and stored.opened is not None and stored.opened.adapter == FORMAT:
            raise UsageError(
                f"run {value(self.run)}: found a run with the names of people as they are, expected one with "
                f"commitments; leave out {option('private_names')}, or give the run another name"
            )
        if robots and robots != stored.robots:
            raise UsageError(
                f"run {value(self.run)}: found {counted(len(stored.robots), 'robot')} with which it began "
                f"({_first(stored.robots)}), expected the same as now ({_first(robots)}); record RobotJoined for "
                "robots that come later, or give the run another name"
            )
        recorded, wanted = {*kept.observes, *kept.records}, {*requested.observes, *requested.records}
        added = {"RobotJoined"} if stored.robots else set()  # by `_begin`
        # No declaration means what the run records.
        if not wanted <= recorded or (wanted and not recorded <= wanted | added):
            raise UsageError(
                f"run {value(self.run)}: found a run that records {_concerns(kept)}, expected {_concerns(requested)}; "
                "declare the same, or give the run another name"
            )
        if started.epoch is None:
            raise UsageError(
                f"run {value(self.run)}: found a run without an epoch, expected one that a recorder began; give "
                "another name"
            )
        if epoch is not None and epoch != utc.parsed(started.epoch):
            raise UsageError(
                f"run {value(self.run)}: found a run that began {started.epoch}, expected {utc.iso_text(epoch)}; leave "
                f"{option('epoch')} out, or give the run another name"
            )
        self.declared = kept
        return utc.parsed(started.epoch)

    def _require_same_supervisors(self, stored: StoredRun, fleet: Fleet) -> None:
        """Refuse a robot with another supervisor than at the beginning; an erased name counts as another."""
        for member in () if isinstance(fleet, Mapping) else fleet:
            earlier, current = stored.supervisors[member.robot], member.supervisor
            if earlier == (current if self._names is None or current is None else self._names.ledger_name(current)):
                continue
            erased = "" if self._names is None else " with the line that the table of names had of them then"
            raise UsageError(
                f"run {value(self.run)}: found {value(earlier or 'nobody')} as the supervisor of {value(member.robot)} "
                f"when it began, expected the same as now ({value(current or 'nobody')}){erased}; "
                "give the run another name"
            )

    def _time_us(self, at: datetime | None) -> int:
        if at is None:
            return max(self._last_us, self.run_time_us(datetime.now(UTC)))
        time_us = self.run_time_us(_moment("at", at))
        if time_us < self._last_us:
            raise UsageError(
                f"at: found {at.isoformat()}, {(self._last_us - time_us) / 1e6:.6f} s before the event before it, "
                "expected no earlier time; the order of a run is that of arrival: leave `at` out, and keep the time of "
                "the source in an observation (`source_time`)"
            )
        return time_us

    def _require_recordable(self, event: Event) -> None:
        kind = type(event).__name__
        if kind in CONCERN_OF and kind not in self.declared.kinds:
            raise InvalidRun(
                f"run {value(self.run)}, seq {self._next}, field type: found {kind}, expected an event that the run "
                f"records ({', '.join(sorted(self.declared.kinds)) or 'none'}); nothing was written: declare it in "
                "`observes` of a new run"
            )
        require_outcome(event)
        alone = LedgerRun(self.run, [0], [None], [event], self._next)
        if (flaw := first_unfit([alone])) is not None:
            raise refusal(flaw)
        for name, content in flat(event).items():
            texts: Sequence[object] = content if isinstance(content, tuple) else (content,)
            if any(isinstance(text, str) and not text.isprintable() for text in texts):
                raise InvalidRun(
                    f"run {value(self.run)}, seq {self._next}, field {name}: found {content!r:.80}, expected "
                    "characters that can be printed; nothing was written"
                )
        require_names(event)
        require_kinds(event)

    def _put(self, time_us: int, caused_by: int | None, event: Event) -> int:
        number = self._next
        if caused_by is not None and not 0 <= caused_by < number:
            raise InvalidRun(
                f"run {value(self.run)}, seq {number}, field caused_by: found {caused_by}, expected the number of an "
                "earlier event; nothing was written"
            )
        if self._batch is None:
            self._commit([(time_us, caused_by, event)])
        else:
            self._batch.append((time_us, caused_by, event))
        self._next, self._last_us = number + 1, time_us
        self._count += isinstance(event, Observed)
        return number

    def _commit(self, rows: Sequence[NewEvent]) -> None:
        if rows:
            first = self._next if self._batch is None else self._next - len(rows)
            commit(self._writer, self._path, self.run, rows, first)


def _moment(name: str, moment: object) -> datetime:
    """Return the datetime of a parameter. Raises: UsageError, which names it, for anything else."""
    if isinstance(moment, datetime):
        return moment
    raise UsageError(
        f"{name}: found {moment!r:.80}, expected a datetime, such as datetime(2026, 3, 1, 10, tzinfo=UTC); "
        "`datetime.fromisoformat` reads it from a text"
    )


def _members(fleet: Fleet) -> Iterator[RobotJoined]:
    """Yield the robots of a fleet. Raises: UsageError for one without a name, or twice."""
    known: set[str] = set()
    for member in _joining(fleet) if isinstance(fleet, Mapping) else fleet:
        require_names(member)
        require_kinds(member)
        if member.robot in known:
            raise UsageError(f"{option('fleet')}: found {value(member.robot)} twice, expected each robot once")
        known.add(member.robot)
        yield member


def _joining(roles: Mapping[str, str]) -> Iterator[RobotJoined]:
    for name, role in roles.items():
        robot = name if name.startswith("robot/") else f"robot/{name}"
        yield RobotJoined(robot=recorded_robot(robot), role=role, supervisor=None)


def roles_of(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Yield the principal and role of each robot of the fleet."""
    return ((member.robot, member.role) for member in _members(fleet))


def _first(robots: Mapping[str, str]) -> str:
    return value(", ".join(sorted(robots)[:3])) + ("..." if len(robots) > 3 else "") if robots else "none"


def _concerns(declaration: Declared) -> str:
    return ", ".join((*declaration.observes, *declaration.records)) or "nothing"
