"""A live federation on a ledger: it takes commands, decides them, and has both on disk before anybody acts on them.

A run that is there goes on: its commands make it again, and where today's handlers decide otherwise than the record
says, it is refused.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import RLock

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.base.printable import value
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.projections.fold import State

from .live import SOURCE, Decision, LiveRun, command_given, decisions_by_key, live_started
from .recipes import recorded_constants
from .run_replay import replay_run

ORIGIN = "fsar-ledger/live"


class Federation:
    """A live run under FSAR's handlers. Use it as a context manager, or call `close`. Safe for threads.

    Args:
        path: The ledger; made if there is none.
        run: The name of the run; one that is there goes on.
        constants: The fleet and what it may spend; those of a run that goes on are on record.
        robots: How many robots the fleet has.
        clock: The time in nanoseconds since 1970.
        origin: The name under which a new ledger is published.
        signer: The key that signs.

    Raises:
        UsageError: Another run has this name, or would go on otherwise than it was recorded.
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
    ) -> None:
        self.run, self._path, self._clock, self._lock = run, path, clock, RLock()
        self._has_failed = False
        self._keys: dict[tuple[str, str], Decision] = {}
        self._writer = Writer(path, origin or (signer.verifier.name if signer else ORIGIN), signer)
        try:
            view = open_ledger(path)
            if view.has_run(run):
                self._resume(next(one for one in view.runs() if one.run_id == run))
            else:
                self._epoch_us = clock() // 1_000
                epoch = utc.shown(utc.EPOCH + self._epoch_us * utc.MICROSECOND)
                self._live = LiveRun(live_started(constants, robots, epoch), constants)
                self._commit()
        except BaseException:
            self._writer.close()
            raise

    @property
    def state(self) -> State:
        """What is known now; it must not be changed."""
        return self._live.kernel.state

    def give(
        self, command: str, by: str, *, key: str | None = None, sent_us: int | None = None, **fields: object
    ) -> Decision:
        """Record a command and decide it; both are on disk when this returns.

        Args:
            command: Its name (`ReportStart`).
            by: Who gives it.
            key: The name by which they tell whether it is the same one again; then its first decision is returned.
            sent_us: When they say that they gave it. Units: microseconds of run time.
            fields: What it says.

        Raises:
            UsageError: There is no such command, or it cannot have these fields. Nothing is on record of it.
            WriteFailed: The disk refused; nobody must act on it.
        """
        return self.decide(command_given(command, by, fields, key, sent_us))

    def decide(self, command: CommandGiven) -> Decision:
        """As `give`, of a command whose record is made (`live.command_given`). Raises: WriteFailed."""
        key = None if command.key is None else (f"{command.issued_by}", command.key)
        with self._lock:
            self._require_whole()
            if key is not None and (before := self._keys.get(key)) is not None:
                return before
            decision = self._live.give(self._now_us(), command)
            self._commit()
            if key is not None:
                self._keys[key] = msgspec.structs.replace(decision, followed=())
            return decision

    def advance(self) -> tuple[Event, ...]:
        """Decide what is due by now, such as a budget that has run out; return the events, which are on disk."""
        with self._lock:
            self._require_whole()
            self._live.advance(self._now_us())
            return self._commit()

    def close(self) -> None:
        """Close the ledger. A federation of the same run continues it."""
        with self._lock:
            self._writer.close()

    def __enter__(self) -> "Federation":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _now_us(self) -> int:
        return self._clock() // 1_000 - self._epoch_us

    def _commit(self) -> tuple[Event, ...]:
        """Put what has happened since the last commit on disk, and return it."""
        piece = self._live.take(self.run)
        if piece.events:
            self._has_failed = True  # until it is on disk, the run knows what nobody may act on
            self._writer.commit([piece])
            self._has_failed = False
        return tuple(piece.events)

    def _require_whole(self) -> None:
        if self._has_failed:
            raise WriteFailed(
                f"run {value(self.run)}: an earlier write failed, so what this process knows is not on disk; open the "
                "federation again once the disk has room"
            )

    def _resume(self, record: LedgerRun) -> None:
        started = record.events[0]
        if not isinstance(started, RunStarted) or started.source != SOURCE or started.epoch is None:
            raise UsageError(f"run {value(self.run)}: found a run that is not live, expected a new name or one that is")
        live = None
        with suppress(Exception):  # whatever keeps it from being made again, its replay tells in words
            constants = recorded_constants(started, len(record.events))
            live = LiveRun(live_started(constants, started.fleet_size or 0, started.epoch), constants, record)
            made = live.take(self.run)  # it is on disk
        if live is None or not _is_same(made, record):
            difference = replay_run(record)
            raise UsageError(f"run {value(self.run)} cannot go on, since it would go on otherwise: {difference}")
        self._live = live
        self._epoch_us = (utc.parsed(started.epoch) - utc.EPOCH) // utc.MICROSECOND
        self._keys = decisions_by_key(record)


def _is_same(made: LedgerRun, record: LedgerRun) -> bool:
    pairs = ((made.times_us, record.times_us), (made.caused_by, record.caused_by), (made.events, record.events))
    return all(list(one) == list(other) for one, other in pairs)
