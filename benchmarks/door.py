"""Measures the door: an import of VDA 5050 messages, and single durable events of a recorder beside SQLite.

    python benchmarks/door.py                      50,000 and 200,000 messages, 2,000 events
    python benchmarks/door.py --lines 5000 20000

Each import runs in a process of its own. Printed are its records per second of wall time and of processor time of all
threads, among them the one that makes segments, and the most memory that the process held: it must not grow with the
input. SQLite (WAL, synchronous FULL) stores the bytes of the same events, ready-made, one transaction each; both take
turns of a fraction of a second, because a disk may be forty times as slow a little later.
"""

import argparse
import os
import resource
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.table import note
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.sources.adapter import adapter_of, opened
from fsar_ledger.sources.importing import import_files
from fsar_ledger.sources.recorder import Recorder

LINES, EVENTS, TURN = (50_000, 200_000), 2_000, 100
WANTED, WANTED_MORE = 50_000, 1.15
"""Records per second of processor time, and the most memory of the largest import by that of the smallest."""


def messages(file: Path, count: int, vehicles: int = 50) -> None:
    """Write so many messages: orders of 20 states each, of vehicles that take turns."""
    with file.open("wb") as out:
        for at in range(count):
            vehicle, step = at % vehicles, at // vehicles
            order, state = f"order-{vehicle}-{step // 21}", step % 21
            header = {
                "headerId": step,
                "timestamp": f"2026-03-01T{step // 3600 % 24:02}:{step // 60 % 60:02}:{step % 60:02}.000Z",
                "version": "2.1.0",
                "manufacturer": "KIT",
                "serialNumber": f"{vehicle:04}",
                "orderId": order,
                "orderUpdateId": 0,
            }
            nodes = [{"nodeId": f"n{node}", "sequenceId": node, "released": True} for node in range(3)]
            status = "WAITING" if state < 5 else "RUNNING" if state < 15 else "FINISHED"
            said: dict[str, object]
            if state == 0:
                kind, said = "order", {"nodes": nodes, "edges": []}
            else:
                kind = "state"
                said = {
                    "lastNodeId": "n0",
                    "driving": state < 18,
                    "operatingMode": "AUTOMATIC",
                    "nodeStates": nodes if state < 18 else [],
                    "edgeStates": [],
                    "actionStates": [{"actionId": f"{order}/1", "actionType": "pick", "actionStatus": status}],
                    "batteryState": {"batteryCharge": 80.0, "charging": False},
                    "errors": [],
                    "safetyState": {"eStop": "NONE", "fieldViolation": False},
                }
            line = {"topic": f"uagv/v2/KIT/{vehicle:04}/{kind}", "payload": header | said}
            out.write(msgspec.json.encode(line) + b"\n")


def import_one(ledger: Path, file: Path) -> None:
    """Import the file, and print records, seconds of wall and processor time, and MiB."""
    adapter, _ = adapter_of("vda5050", None)
    wall, processor = time.perf_counter(), time.process_time()
    with opened([str(file)]) as inputs:
        records = import_files(ledger, inputs, adapter, run="night").records
    spent = time.perf_counter() - wall, time.process_time() - processor
    print(records, *spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def imports(folder: Path, sizes: list[int]) -> bool:
    """Import recordings of these sizes, and print what each took. Returns whether memory stayed as it was."""
    held = []
    for size in sizes:
        messages(folder / "night.jsonl", size)
        command = [sys.executable, __file__, "--one", str(folder / f"{size}"), str(folder / "night.jsonl")]
        said = subprocess.run(command, capture_output=True, check=True, text=True).stdout
        records, wall, processor, mebibytes = map(float, said.split())
        held.append(mebibytes)
        print(
            f"import of {size:>9,} messages: {records / wall:>7,.0f} records/s, of processor time "
            f"{records / processor:>7,.0f} (wanted: {WANTED:,}); {mebibytes:,.0f} MiB at most"
        )
    note("import of VDA 5050, most memory", f"{held[-1]:,.0f} MiB", f"{held[0]:,.0f} MiB of the smallest", "the same")
    print(f"memory, largest by smallest: ratio {held[-1] / held[0]:.2f} (wanted: at most {WANTED_MORE})")
    return held[-1] <= WANTED_MORE * held[0]


def spent(work: Callable[[], object]) -> float:
    """Return the seconds of wall time that this took."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def told(recorder: Recorder, first: int) -> None:
    for number in range(first, first + TURN):
        recorder.event(TaskArrived(task_id=f"task/{number}", robot=None))


def inserted(connection: sqlite3.Connection, rows: list[bytes]) -> None:
    for row in rows:
        connection.execute("INSERT INTO events (row) VALUES (?)", (row,))


def events(folder: Path, count: int) -> None:
    """Record single events here and there, in turns, and print what they took."""
    connection = sqlite3.connect(folder / "events.db", isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("CREATE TABLE events (id INTEGER PRIMARY KEY, row BLOB)")
    ours, theirs = list[float](), list[float]()
    with Recorder(folder / "site", observes=["TaskArrived"], run="night") as recorder:
        recorder.event(TaskArrived(task_id="first", robot=None))
        row = next(iter(open_ledger(folder / "site").rows(2, 3)))
        for first in range(0, count, TURN):
            ours.append(spent(partial(told, recorder, first)))
            theirs.append(spent(partial(inserted, connection, [bytes(row)] * TURN)))
    connection.close()
    mine, peer = (len(ours) * TURN / sum(found) for found in (ours, theirs))
    quicker = sum(one <= other for one, other in zip(ours, theirs, strict=True)) / len(ours)
    note("single durable events of a recorder", f"{mine:,.0f}/s", f"SQLite {peer:,.0f}/s", "ratio 1")
    print(
        f"single events: {mine:,.0f} events/s, SQLite {peer:,.0f}, ratio {mine / peer:.2f} (wanted: 1), quicker in "
        f"{quicker:.0%} of turns"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, nargs="+", default=LINES)
    parser.add_argument("--events", type=int, default=EVENTS)
    parser.add_argument("--one", type=Path, nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        import_one(*options.one)
        return 0
    print(f"load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as folder:
        is_flat = imports(Path(folder), list(options.lines))
        events(Path(folder), options.events)
    return 0 if is_flat else 1


if __name__ == "__main__":
    sys.exit(main())
