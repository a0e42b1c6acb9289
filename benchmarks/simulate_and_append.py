"""Measures events per second from world to committed ledger, against the PyPI package `eventsourcing`.

    python benchmarks/simulate_and_append.py             the paper's 300 runs
    python benchmarks/simulate_and_append.py --runs 4    a small run

Ours simulates, hashes and commits. `eventsourcing` makes its event objects of the same events and stores them (SQLite
application recorder, WAL, its default JSON transcoder, 150 events a save), and need not simulate. Each measurement has
a process of its own.
"""

import argparse
import multiprocessing
import resource
import statistics
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from fsar_ledger.events import EVENT_TYPES
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import stored_type
from fsar_ledger.ledger.store.read import open_ledger
from fsar_ledger.runtime.experiment import Experiment, simulate
from fsar_ledger.runtime.simulation import ARCHITECTURES, SCENARIOS

EVENTS_PER_SAVE = 150
BYTES_PER_MIB = 1024


class Measurement(NamedTuple):
    """One measurement of a process.

    Units: `seconds` wall; `saving_seconds` the part of it that saved finished event objects; `peak_kib` the largest
    resident set of the process and of each of its children.
    """

    events: int
    seconds: float
    saving_seconds: float
    peak_kib: int


def simulate_and_append(folder: Path, runs: int, workers: int) -> Measurement:
    """Measure from world to committed ledger, with imports and the start of worker processes."""
    experiment = Experiment(
        architectures=ARCHITECTURES,
        scenarios=SCENARIOS,
        runs=runs,
        seed=42,
        fleet_size=4,
        configurations=("full",),
    )
    began = time.perf_counter()
    head = simulate(folder, experiment, workers, None)
    seconds = time.perf_counter() - began
    return Measurement(head.size, seconds, seconds, peak_kib())


def peak_kib() -> int:
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def store_with_eventsourcing(ledger: Path, database: Path) -> Measurement:
    """Store the ledger's events in an SQLite database; reading them from the ledger is not timed."""
    from eventsourcing.persistence import DatetimeAsISO, DecimalAsStr, EventStore, JSONTranscoder, Mapper, UUIDAsHex
    from eventsourcing.sqlite import SQLiteApplicationRecorder, SQLiteDatastore

    transcoder = JSONTranscoder()
    for transcoding in (UUIDAsHex(), DecimalAsStr(), DatetimeAsISO()):  # what an eventsourcing.Application registers
        transcoder.register(transcoding)
    recorder = SQLiteApplicationRecorder(SQLiteDatastore(str(database)))
    recorder.create_table()
    store: EventStore[uuid.UUID] = EventStore(Mapper(transcoder), recorder)
    classes = domain_classes()
    stored, making_s, saving_s = 0, 0.0, 0.0
    for run in open_ledger(ledger).runs():
        began = time.perf_counter()
        events = domain_events(run, classes)
        made = time.perf_counter()
        for at in range(0, len(events), EVENTS_PER_SAVE):
            store.put(events[at : at + EVENTS_PER_SAVE])
        making_s += made - began
        saving_s += time.perf_counter() - made
        stored += len(events)
    if (recorder.max_notification_id() or 0) != stored:
        raise AssertionError(f"eventsourcing holds {recorder.max_notification_id()} events, expected {stored}")
    return Measurement(stored, making_s + saving_s, saving_s, peak_kib())


def domain_classes() -> dict[type, type[Any]]:
    """Make one frozen `DomainEvent` class for each of our event types, with the same fields and the envelope."""
    from eventsourcing.domain import DomainEvent

    metaclass: Any = type(DomainEvent)
    made: dict[type, type[Any]] = {}
    for kind in EVENT_TYPES:
        fields = dict.fromkeys(("caused_by", "time_us", *(field.name for field in stored_type(kind).fields)), Any)
        made[kind] = metaclass(
            kind.__name__,
            (DomainEvent,),
            {"__annotations__": fields, "__module__": __name__, "__qualname__": kind.__name__},
        )
        globals()[kind.__name__] = made[kind]
    return made


def domain_events(run: LedgerRun, classes: dict[type, type[Any]]) -> list[Any]:
    """Return the events of a run for `eventsourcing`: an aggregate per run, versions from 1."""
    from eventsourcing.domain import datetime_now_with_tzinfo

    aggregate, now = uuid.uuid5(uuid.NAMESPACE_OID, run.run_id), datetime_now_with_tzinfo()
    return [
        classes[type(event)](
            originator_id=aggregate,
            originator_version=version,
            timestamp=now,
            caused_by=cause,
            time_us=time_us,
            **flat(event),
        )
        for version, (event, cause, time_us) in enumerate(
            zip(run.events, run.caused_by, run.times_us, strict=True), start=1
        )
    ]


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


def rate(measurements: list[Measurement]) -> float:
    return statistics.median(one.events / one.seconds for one in measurements)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=20, help="runs per scenario and architecture")
    parser.add_argument(
        "--scaling-runs",
        type=int,
        help="the same for one worker against two; more, because two also take time to start",
        default=None,
    )
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    scaling_runs = options.scaling_runs or 8 * options.runs
    ours, theirs, one, two = [], [], [], []
    with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as name:
        folder = Path(name)
        for turn in range(options.repeats):  # in turn, so that a slow moment of the machine hits all
            ours.append(apart(simulate_and_append, folder / f"ours-{turn}", options.runs, 1))
            theirs.append(apart(store_with_eventsourcing, folder / f"ours-{turn}", folder / f"theirs-{turn}.db"))
            one.append(apart(simulate_and_append, folder / f"one-{turn}", scaling_runs, 1))
            two.append(apart(simulate_and_append, folder / f"two-{turn}", scaling_runs, 2))
        segments = sum(path.stat().st_size for path in open_ledger(folder / "ours-0").segments())
        database = (folder / "theirs-0.db").stat().st_size
    events = ours[0].events
    print(f"events                              {events:>12,}")
    print(f"fsar-ledger, world to committed     {rate(ours):>12,.0f} events/s on one core")
    saving = statistics.median(run.events / run.saving_seconds for run in theirs)
    print(f"eventsourcing, making and saving    {rate(theirs):>12,.0f} events/s")
    print(f"eventsourcing, saving alone         {saving:>12,.0f} events/s")
    ratio, against_saving, scaling = rate(ours) / rate(theirs), rate(ours) / saving, rate(two) / rate(one)
    print(f"fsar-ledger / eventsourcing         {ratio:>12.2f} (target: at least 4; ", end="")
    print(f"{against_saving:.2f} against saving alone)")
    print(f"two workers / one                   {scaling:>12.2f} (target: at least 1.7; {one[0].events:,} events)")
    peak = max(run.peak_kib for run in (*ours, *one, *two)) / BYTES_PER_MIB
    print(f"peak memory of a process            {peak:>12.0f} MiB (target: under 500)")
    small, large = ours[0].peak_kib / BYTES_PER_MIB, one[0].peak_kib / BYTES_PER_MIB
    print(f"... with {scaling_runs / options.runs:>4g} times the runs         {large:>12.0f} MiB ", end="")
    print(f"(target: flat; {small:.0f} before)")
    print(f"bytes per event in segments/        {segments / events:>12.1f} (target: at most 25; ", end="")
    print(f"eventsourcing {database / events:.0f})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
