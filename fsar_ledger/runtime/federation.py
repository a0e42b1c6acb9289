"""A live federation on a ledger: it decides commands, and writes both to disk before anybody acts on them.

An existing run is continued: it is rebuilt from its commands, and refused if today's handlers decide otherwise than the
record says.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from threading import RLock
from types import GenericAlias
from typing import Any, TypeVar, Union

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import InvalidRun, SequenceConflict, UsageError, WriteFailed
from fsar_ledger.base.printable import counted, value
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import EVENT_TYPES, Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun, counted_on
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.locations import chain_of, event_count, record_of, whole_of
from fsar_ledger.ledger.store.read import View
from fsar_ledger.projections.fold import State

from . import snapshot
from .isolation import Isolation
from .live import AT_ONCE_US, SOURCE, Decision, LiveRun, command_given, decision_of, live_started
from .recipes import recorded_constants
from .run_replay import replay_run

ORIGIN = "fsar-ledger/live"
KEEP_AFTER, KEEP_AT_END = 1 << 16, 1 << 13
"""Events after the newest snapshot until the next; at the end, fewer are not worth one: rebuilding them is quick."""
DAY_US = 86_400_000_000
KEYS = 1 << 16
"""How many of the last commands with a key are remembered with their decisions; an older one counts as new."""

_Answer = TypeVar("_Answer")
_EVENTS = GenericAlias(tuple, (Union[EVENT_TYPES], ...))  # noqa: UP007  the types are in a tuple
_KNOWN: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(
    GenericAlias(tuple, (str, str, int, _EVENTS, str | None))
)
"""A command with a key and its decision: name, parameters, seq, events, why it was rejected."""


class Federation:
    """A live run under FSAR's handlers. Use it as a context manager, or call `close`. Safe for threads.

    Args:
        path: The ledger; made if there is none.
        run: The name of the run; an existing one is continued, and the newest of those that continue each other.
        constants: The fleet and its budgets; an existing run has them on record.
        robots: How many robots the fleet has.
        clock: The time in nanoseconds since 1970.
        origin: The name under which a new ledger is published.
        signer: The key that signs.
        on_commit: Called after each commit with the seq of its first event and its rows, as they are hashed, a line
            each. Runs that continue each other share one count of seqs.
        cuts_us: When the run is cut (`cut`): microseconds after midnight in UTC.
        isolation: Where a robot alone starts from, if the run is its own and new (`isolation_of`).

    Raises:
        UsageError: Another run has this name, or today's handlers do not reproduce its record, or another process
            governs it.
        NotALedger, LedgerCorrupted, WriteFailed: As `Writer`.
    """

    def __init__(
        self,
        path: Path,
        run: str,
        constants: Constants,
        robots: int,
        clock: Callable[[], int],
        *,
        origin: str | None = None,
        signer: Signer | None = None,
        on_commit: Callable[[int, bytes], None] | None = None,
        cuts_us: Sequence[int] = (),
        isolation: Isolation | None = None,
    ) -> None:
        self._on_commit, self._cuts_us = on_commit, tuple(sorted(cuts_us))
        self._path, self._clock, self._lock = path, clock, RLock()
        self._before = 0  # how many events the earlier runs have that this one continues, without its own event 0
        self._is_ahead = False  # whether the state may have events that are not on disk
        self._overtaken = ""  # the error, once another process has written the run
        self._kept = 0  # how many events the newest snapshot covers
        # Packed: a snapshot of so many objects would take 1.6 s, one of their bytes takes 0.1. A plain dict would take
        # 40 microseconds to find its first key behind all the removed ones.
        self._keys: OrderedDict[str, bytes] = OrderedDict()
        self._writer = Writer(path, origin or (signer.verifier.name if signer else ORIGIN), signer)
        self._hold: snapshot.Hold | None = None
        try:
            view = open_ledger(path)
            self.run, self._first = newest_of(view, run)
            self._hold = snapshot.Hold(path, self._first)
            if view.has_run(self.run):
                if not self._recall(view):
                    self._resume(view)
            else:
                self._begin_new_run(constants, robots, isolation)
                self._commit()
        except BaseException:
            self._end()
            raise

    def _begin_new_run(self, constants: Constants, robots: int, isolation: Isolation | None) -> None:
        """Begin a new run: of a fleet, at this moment, or of a robot alone, in the run time of its fleet."""
        now_us = self._clock() // 1_000
        if isolation is None:
            self._begin(live_started(constants, robots, utc.shown_us(now_us)), 0)
            self._epoch_us = now_us
            self._live = LiveRun(self._started, constants)
            return
        self._begin(live_started(isolation.constants, 1, isolation.epoch), 0)
        self._live = LiveRun(self._started, isolation.constants, alone=isolation.founding)
        self._live.kernel.happen(now_us - self._epoch_us, isolation.began)
        self._live.advance(self._live.kernel.last_us + AT_ONCE_US)

    @property
    def started(self) -> RunStarted:
        """Event 0 of the run, which records its settings."""
        return self._started

    @property
    def state(self) -> State:
        """The present state; it must not be modified."""
        return self._live.kernel.state

    @property
    def size(self) -> int:
        """How many events the run has, including those of the runs that it continues."""
        return self._live.kernel.first + len(self._live.kernel.events)

    def ask(self, question: Callable[[State, int], _Answer]) -> _Answer:
        """Call the function with the present state and run time (microseconds), and return its answer."""
        with self._lock:
            return question(self.state, self._now_us())

    def give(
        self, command: str, by: str, *, key: str | None = None, sent_us: int | None = None, **fields: object
    ) -> Decision:
        """Record a command and decide it; both are on disk when this returns.

        Args:
            command: Its name (`ReportStart`).
            by: Who gives it.
            key: Identifies a repeated command, whose first decision is returned then. The last 65,536 are remembered.
            sent_us: When the sender says it was sent. Units: microseconds of run time.
            fields: Its fields.

        Raises:
            UsageError: There is no such command, it cannot have these fields, or its key was given with another
                command. Nothing of it is recorded.
            WriteFailed: The disk refused; nobody must act on it.
        """
        return self.decide(command_given(command, by, fields, key, sent_us))

    def decide(self, command: CommandGiven) -> Decision:
        """As `give`, for a command that is already an event (`live.command_given`)."""
        [decision] = self.decide_all((command,))
        if isinstance(decision, UsageError):
            raise decision
        return decision

    def decide_all(self, commands: Sequence[CommandGiven]) -> list[Decision | UsageError]:
        """Decide each command in turn, in one write; return an error for a key that belongs to another command.

        Raises: WriteFailed: The new decisions may not be on disk; nobody must act on any of them.
        """
        with self._lock:
            self._require_whole()
            self._cut_if_due()
            decisions = [self._decided(command) for command in commands]
            self._commit()
            return decisions

    def _decided(self, command: CommandGiven) -> Decision | UsageError:
        if command.key is None:
            return self._live.give(self._now_us(), command)
        key, content = (f"{command.issued_by}", command.key), (command.command, command.parameters)
        if (packed := self._keys.get("\n".join(key))) is None:
            decision = self._live.give(self._now_us(), command)
            self._remember(key, content, decision)
            return decision
        name, parameters, seq, events, reason = _KNOWN.decode(packed)
        if (name, parameters) == content:
            return Decision(seq, events, reason)
        return UsageError(
            f"key {value(command.key)}: found another {value(command.command)} than the {value(name)} at seq {seq}, "
            "expected a new key for a new command"
        )

    def _remember(self, key: tuple[str, str], content: tuple[str, str], decision: Decision) -> None:
        packed = msgspec.msgpack.encode((*content, decision.seq, decision.events, decision.rejected))
        self._keys["\n".join(key)] = packed  # neither part has a line feed
        if len(self._keys) > KEYS:
            self._keys.popitem(last=False)

    def _remember_from(self, record: LedgerRun | None) -> None:
        for key, decided in ({} if record is None else _decisions_by_key(record, KEYS)).items():
            self._remember(key, *decided)

    def advance(self) -> tuple[Event, ...]:
        """Decide what is due by now, such as an exhausted budget; return the events, which are on disk."""
        with self._lock:
            self._require_whole()
            self._cut_if_due()
            self._live.advance(self._now_us())
            return self._commit()

    def cut(self) -> str:
        """End the run here and continue it as a new one; return the name of that.

        Open work continues in it: `RunContinued` records where from. Seqs and times count on. Raises: WriteFailed.
        """
        with self._lock:
            self._require_whole()
            self._cut(self._now_us())
            return self.run

    def _cut(self, now_us: int) -> None:
        self._live.advance(now_us - 1)
        self._commit()
        earlier, seq = self.run, self.size - 1 - self._before
        runs = self._writer.existing_runs().runs  # opening the ledger would take longer with each commit
        self._live.cut(now_us - 1, earlier, seq, self._writer.head.root)
        self._before += seq
        number = int(earlier.removeprefix(f"{self._first}.")) if earlier != self._first else 1
        self.run = next(name for later in count(number + 1) if (name := f"{self._first}.{later}") not in runs)
        self._commit()
        self._keep()
        snapshot.drop(self._path, earlier)

    def _cut_if_due(self) -> None:
        """Cut the run at the latest scheduled moment, if that lies between its beginning and now."""
        if not self._cuts_us:
            return
        now_us = self._now_us() + self._epoch_us
        days = (now_us - now_us % DAY_US, now_us - now_us % DAY_US - DAY_US)
        passed = [day_us + at_us - self._epoch_us for day_us in days for at_us in self._cuts_us]
        last_us = max((cut_us for cut_us in passed if cut_us + self._epoch_us <= now_us), default=0)
        if last_us - 1 > self._began_us:
            self._cut(last_us)
            self._is_ahead = True  # again

    def close(self) -> None:
        """Close the ledger. A federation of the same run continues it."""
        with self._lock:
            if not self._is_ahead and self.size - self._kept >= KEEP_AT_END:
                self._keep()
            self._end()

    def _end(self) -> None:
        try:
            self._writer.close()
        finally:
            if self._hold is not None:
                self._hold.release()

    def __enter__(self) -> "Federation":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _now_us(self) -> int:
        return self._clock() // 1_000 - self._epoch_us

    def _commit(self) -> tuple[Event, ...]:
        """Commit the events since the last commit, pass them to `on_commit`, and return them."""
        piece = self._live.take(self.run)
        if not piece.events:
            self._is_ahead = False
        else:
            begins = isinstance(piece.events[0], RunContinued)
            stored = counted_on(piece, -self._before) if self._before else piece
            self._write(self._continuing_run(stored) if begins else stored)
            self._is_ahead = False
            if begins:
                self._began_us = piece.times_us[0]
            if self.size - self._kept >= KEEP_AFTER:
                self._keep()
            if self._on_commit is not None:
                rows = self._writer.newest_rows()
                self._on_commit(piece.first, rows.partition(b"\n")[2] if begins else rows)
        return tuple(piece.events)

    def _write(self, piece: LedgerRun) -> None:
        """Commit this piece. Raises: SequenceConflict if another process has written the run meanwhile; as `Writer`."""
        try:
            self._writer.commit([piece])
        except InvalidRun as error:
            size = event_count(open_ledger(self._path).parts(self.run))
            if size == piece.first:
                raise
            self._overtaken = (
                f"run {value(self.run)}: found {counted(size, 'event')} on record, expected the {piece.first:,} that "
                "this process knows; another process has written this run meanwhile: stop one of them, and start this "
                "one again"
            )
            raise SequenceConflict(self._overtaken) from error

    def _continuing_run(self, piece: LedgerRun) -> LedgerRun:
        """Return the beginning of a run that continues another: this piece after an event 0 like the other's."""
        times_us, causes = (piece.times_us[0], *piece.times_us), (None, *piece.caused_by)
        return LedgerRun(self.run, times_us, causes, (self._started, *piece.events), goes_on=True)

    def _require_whole(self) -> None:
        if self._overtaken:
            raise SequenceConflict(self._overtaken)
        if self._is_ahead:
            raise WriteFailed(
                f"run {value(self.run)}: an earlier decision or write failed, so what this process knows is not on "
                "disk; open the federation again once the disk has room"
            )
        self._is_ahead = True  # until what is decided next is on disk, nobody may act on the state in memory

    def _keep(self) -> None:
        """Save a snapshot of the run, for the next federation of it."""
        known = (self._started, self._live.kernel.saved_state(), self._keys, self._before, self._began_us)
        snapshot.save(self._path, self.run, self._writer.head, known)
        self._kept = self.size

    def _recall(self, view: View) -> bool:
        """Continue from the snapshot, if it is valid and reproduces the events recorded after it; return whether."""
        with suppress(Exception):  # the run is rebuilt from its beginning instead
            if (loaded := snapshot.load(view, self.run)) is not None:
                (started, known, keys, before, began_us), record = loaded
                record = None if record is None else counted_on(record, before)
                live = LiveRun(started, recorded_constants(started, known[0]), record, known)
                made = live.take(self.run)
                if record is None or _is_same(made, record):
                    self._live, self._kept, self._keys, self._before = live, known[0], keys, before
                    self._begin(started, began_us)
                    self._remember_from(record)
                    return True
        return False

    def _begin(self, started: RunStarted, began_us: int) -> None:
        self._started, self._began_us = started, began_us
        self._epoch_us = utc.microseconds(utc.parsed(f"{started.epoch}"))

    def _resume(self, view: View) -> None:
        record = record_of(view, self.run)
        started = record.events[0]
        if not isinstance(started, RunStarted) or started.source != SOURCE or started.epoch is None:
            raise UsageError(f"run {value(self.run)}: found a run that is not live, expected a new name or one that is")
        live = None
        with suppress(Exception):  # whatever prevents it, the replay below says what differs
            constants = recorded_constants(started, len(record.events))
            live = LiveRun(live_started(constants, started.fleet_size or 0, started.epoch), constants, record)
            made = live.take(self.run)  # already on disk
        if live is None or not _is_same(made, record):
            difference = replay_run(record)
            raise UsageError(f"run {value(self.run)} cannot continue, since it would continue otherwise: {difference}")
        self._live, self._before = live, len(record.events) - event_count(view.parts(self.run))
        self._begin(started, record.times_us[self._before + 1] if self._before else 0)
        self._remember_from(record)


def newest_of(view: View, run: str) -> tuple[str, str]:
    """Return the newest and the first of the runs that continue each other, one of which has this name."""
    if not view.has_run(run):
        return run, run
    return whole_of(view, run), chain_of(view, run)[0]


def _decisions_by_key(record: LedgerRun, most: int) -> dict[tuple[str, str], tuple[tuple[str, str], Decision]]:
    """Return the last `most` commands with a key, and their decisions, by sender and key.

    A command is its name and its fields, as JSON.
    """
    pairs = [
        (seq, event)
        for seq, event in enumerate(record.events, record.first)
        if isinstance(event, CommandGiven) and event.key is not None
    ]
    keyed = dict(pairs[-most:])
    events: dict[int, list[Event]] = {seq: [] for seq in keyed}
    for event, cause in zip(record.events, record.caused_by, strict=True):
        if cause in events:
            events[cause].append(event)
    return {
        (f"{given.issued_by}", f"{given.key}"): ((given.command, given.parameters), decision_of(seq, events[seq]))
        for seq, given in keyed.items()
    }


def _is_same(made: LedgerRun, record: LedgerRun) -> bool:
    pairs = ((made.times_us, record.times_us), (made.caused_by, record.caused_by), (made.events, record.events))
    return all(list(left) == list(right) for left, right in pairs)
