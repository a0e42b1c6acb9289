"""Other stores of events, each in the best configuration that we know, and how to measure them in turn with ours.

`eventsourcing` stores msgspec structs with a mapper that encodes them with msgspec, ids as text, SQLite in WAL mode
with its default `synchronous` (FULL), 10,000 events a save. SQLite itself stores the same bytes as our leaves: WAL,
`synchronous` FULL, one table, 10,000 rows a transaction, one prepared INSERT. None of them hashes.
"""

import gc
import multiprocessing
import os
import resource
import sqlite3
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.ledger.rows.runs import LedgerRun

EVENTS_PER_SAVE = 10_000
KIB_PER_MIB = 1024


class Measurement(NamedTuple):
    """One measurement of a process. Units: `wall_s` and `cpu_s` (of the process and its children) seconds, `peak_mib`
    the largest resident set of the process or of one of its children."""

    events: int
    wall_s: float
    cpu_s: float
    peak_mib: float


def measured(work: Callable[[], int]) -> Measurement:
    """Measure work that returns how many events it was about; what is there before is no work for the collector."""
    gc.collect()
    gc.freeze()
    before, began = os.times(), time.perf_counter()
    events = work()
    wall_s, after = time.perf_counter() - began, os.times()
    peaks = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return Measurement(events, wall_s, sum(after[:4]) - sum(before[:4]), max(peaks) / KIB_PER_MIB)


def apart(work: Callable[..., Measurement], *arguments: Any) -> Measurement:
    """Take the measurement in a fresh process."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, work, arguments))
    process.start()
    sender.close()
    try:
        result: Measurement = receiver.recv()
    finally:
        process.join()
    return result


def _send(sender: Any, work: Callable[..., Measurement], arguments: tuple[Any, ...]) -> None:
    sender.send(work(*arguments))


def wall_rate(found: Sequence[Measurement]) -> float:
    """Return the median of events per second of wall time."""
    return statistics.median(one.events / one.wall_s for one in found)


def cpu_rate(found: Sequence[Measurement]) -> float:
    """Return the median of events per second of processor time."""
    return statistics.median(one.events / one.cpu_s for one in found)


class Stored(msgspec.Struct, frozen=True, gc=False):
    """An event as `eventsourcing` takes it: an aggregate a run, versions from 1."""

    originator_id: str
    originator_version: int
    time_us: int
    caused_by: int | None
    event: Event


def eventsourcing_saves(runs: Iterable[LedgerRun], database: Path) -> int:
    """Store the events of these runs with `eventsourcing`. Raises: AssertionError if some are missing afterwards."""
    from eventsourcing.persistence import EventStore, JSONTranscoder, Mapper, StoredEvent
    from eventsourcing.sqlite import SQLiteApplicationRecorder, SQLiteDatastore

    encode = msgspec.json.Encoder().encode

    class MsgspecMapper(Mapper[str]):
        def to_stored_event(self, domain_event: Any) -> StoredEvent:
            state = encode((domain_event.time_us, domain_event.caused_by, domain_event.event))
            topic = type(domain_event.event).__name__
            return StoredEvent(domain_event.originator_id, domain_event.originator_version, topic, state)

    recorder = SQLiteApplicationRecorder(SQLiteDatastore(str(database), originator_id_type="text"))
    recorder.create_table()
    store: EventStore[str] = EventStore(MsgspecMapper(JSONTranscoder()), recorder)
    waiting: list[Any] = []
    events = 0
    for run in runs:
        events += len(run.events)
        rows = zip(run.times_us, run.caused_by, run.events, strict=True)
        waiting += [Stored(run.run_id, version, *row) for version, row in enumerate(rows, start=1)]
        while len(waiting) >= EVENTS_PER_SAVE:
            store.put(waiting[:EVENTS_PER_SAVE])
            del waiting[:EVENTS_PER_SAVE]
    store.put(waiting)
    if recorder.max_notification_id() != events:
        raise AssertionError(f"eventsourcing holds {recorder.max_notification_id()} events, expected {events}")
    return events


def sqlite_saves(rows: Iterable[bytes], database: Path, per_save: int = EVENTS_PER_SAVE) -> int:
    """Store these bytes with SQLite. Raises: AssertionError if some are missing afterwards."""
    connection = sqlite3.connect(database, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("CREATE TABLE events (id INTEGER PRIMARY KEY, row BLOB)")
    given, events = iter(rows), 0
    while some := [(row,) for row in islice(given, per_save)]:
        connection.execute("BEGIN")
        connection.executemany("INSERT INTO events (row) VALUES (?)", some)
        connection.execute("COMMIT")
        events += len(some)
    (held,) = connection.execute("SELECT count(*) FROM events").fetchone()
    connection.close()
    if held != events:
        raise AssertionError(f"SQLite holds {held} rows, expected {events}")
    return events
