"""Measures commits per second into the journal of a ledger, against SQLite with the same bytes.

    python benchmarks/journal.py                groups of 1, 10, 100 and 1,000 events

SQLite is given the bytes ready-made and stores them (WAL, synchronous FULL, one table, one transaction a group, one
prepared INSERT). Ours encodes, checks and hashes the events as well, and puts full journals into segments, in a thread
of its own; its time ends when that has finished. Both take turns of a fraction of a second, because a disk may be forty
times as slow a little later. Printed are events per second of wall time and of processor time, of all threads, and how
often the turn of ours was the quicker one.
"""

import argparse
import gc
import os
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import rows_of
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

GROUPS = {1: 1_000, 10: 1_000, 100: 4_800, 1_000: 480}
"""Of each size, how many are stored in a turn; 29 journals full of the larger ones; the last is waited for."""
MOST_ROWS = 60_000
"""Events of a run that are stored; then another one follows."""


class Spent(NamedTuple):
    """Units: seconds of wall time, and of processor time."""

    wall: float
    processor: float


def spent(work: Callable[[], object]) -> Spent:
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return Spent(time.perf_counter() - wall, time.process_time() - processor)


def renamed(run: LedgerRun, name: str) -> LedgerRun:
    return LedgerRun(f"{run.run_id}-{name}", run.times_us, run.caused_by, run.events)


def pieces_of(run: LedgerRun, group: int, groups: int) -> list[LedgerRun]:
    """Cut the beginning of the run into groups of events."""
    return [piece(run, at, at + group) for at in range(0, group * groups, group)]


def cut(run: LedgerRun, group: int, groups: int, turn: int) -> list[LedgerRun]:
    """Cut runs like this one into so many groups of events for one turn, each run with another name."""
    most = MOST_ROWS // group
    return [
        part
        for first in range(0, groups, most)
        for part in pieces_of(renamed(run, f"{turn}-{first}"), group, min(most, groups - first))
    ]


def stored(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("CREATE TABLE events (id INTEGER PRIMARY KEY, row BLOB)")
    return connection


def insert(connection: sqlite3.Connection, groups: list[list[tuple[bytes]]]) -> None:
    for rows in groups:
        connection.execute("BEGIN")
        connection.executemany("INSERT INTO events (row) VALUES (?)", rows)
        connection.execute("COMMIT")


def add(writer: Writer, groups: list[LedgerRun]) -> None:
    for group in groups:
        writer.add([group])
    writer.settle()


def paired(run: LedgerRun, group: int, groups: int, turns: int) -> tuple[list[Spent], list[Spent]]:
    """Store the same groups here and there, in turns; return what each took."""
    ours, theirs = [], []
    with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as name:
        path = Path(name) / "ledger"
        connection = stored(Path(name) / "events.db")
        with Writer(path, "example.org/journal") as writer:
            writer.add([LedgerRun("begun", [0], [None], run.events[:1])])
            writer.seal()  # as in any ledger that is not quite new, there is a chain
            for turn in range(turns):
                pieces = cut(run, group, groups, turn)
                parts = [[(row,) for row in rows_of([part])[0].splitlines()] for part in pieces]
                ours.append(spent(partial(add, writer, pieces)))
                theirs.append(spent(partial(insert, connection, parts)))
        connection.close()
        if open_ledger(path).head.size != group * groups * turns + 1:
            raise AssertionError("events are missing")
    return ours, theirs


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--turns", type=int, default=8)
    options = parser.parse_args()
    run = simulate_run(RunSpec(42, "fsar", "full", "fleet-contention", 512, 0), Constants())
    size = sum(map(len, encode_lines([run]))) / len(run.events)
    gc.collect()
    gc.freeze()  # else what was made here is gone through again and again, in the time of whoever happens to allocate
    print(f"load {os.getloadavg()[0]:.1f}, {len(run.events):,} events, {size:.0f} bytes each")
    for group, groups in GROUPS.items():
        ours, theirs = paired(run, group, groups, options.turns)
        events = group * groups * options.turns
        mine, peer = (events / sum(one.wall for one in found) for found in (ours, theirs))
        used, peer_used = (events / sum(one.processor for one in found) for found in (ours, theirs))
        quicker = sum(one.wall <= other.wall for one, other in zip(ours, theirs, strict=True)) / len(ours)
        print(
            f"groups of {group:>5,}: {mine:>9,.0f} events/s, SQLite {peer:>9,.0f}, ratio {mine / peer:.2f} (wanted: "
            f"1), quicker in {quicker:.0%} of turns; of processor time {used:>9,.0f}, SQLite {peer_used:>9,.0f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
