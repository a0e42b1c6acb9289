"""Measures commits per second into the journal of a ledger of format 2, against SQLite with the same bytes.

    python benchmarks/journal.py                groups of 1, 10, 100 and 1,000 events

SQLite is given the bytes ready-made and stores them (WAL, synchronous FULL, one table, one transaction a group, one
prepared INSERT). Ours encodes, checks and hashes the events as well. Both take turns, group by group size; printed are
medians of events per second of wall time, and of processor time.
"""

import argparse
import os
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.constants import Constants
from fsar_ledger.ledger.chain.append import ChainWriter
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

GROUPS = {1: 2_000, 10: 1_000, 100: 300, 1_000: 60}


class Rate(NamedTuple):
    """Units: events per second of wall time, and of processor time."""

    wall: float
    processor: float


def timed(work: Callable[[], object], events: int) -> Rate:
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return Rate(events / (time.perf_counter() - wall), events / (time.process_time() - processor))


def journal(run: LedgerRun, path: Path, group: int, groups: int) -> Rate:
    """Measure groups of one run that goes on."""
    pieces = [
        LedgerRun(
            run.run_id,
            run.times_us[at : at + group],
            run.caused_by[at : at + group],
            run.events[at : at + group],
            at,
            True,
        )
        for at in range(0, group * groups, group)
    ]
    with ChainWriter(path, "example.org/journal") as writer:
        writer.add([LedgerRun("begun", [0], [None], run.events[:1])])

        def work() -> None:
            for piece in pieces:
                writer.add([piece])

        found = timed(work, group * groups)
    if open_ledger(path).head.size != group * groups + 1:
        raise AssertionError("events are missing")
    return found


def sqlite(rows: list[bytes], path: Path, group: int, groups: int) -> Rate:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("CREATE TABLE events (id INTEGER PRIMARY KEY, row BLOB)")
    parts = [[(row,) for row in rows[at : at + group]] for at in range(0, group * groups, group)]

    def work() -> None:
        for part in parts:
            connection.execute("BEGIN")
            connection.executemany("INSERT INTO events (row) VALUES (?)", part)
            connection.execute("COMMIT")

    found = timed(work, group * groups)
    connection.close()
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    run = simulate_run(RunSpec(42, "fsar", "full", "fleet-contention", 512, 0), Constants())
    rows = encode_lines([run])
    print(
        f"load {os.getloadavg()[0]:.1f}, {len(run.events):,} events, {sum(map(len, rows)) / len(rows):.0f} bytes each"
    )
    for group, groups in GROUPS.items():
        ours, theirs = [], []
        for _ in range(options.repeats):
            with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as name:
                ours.append(journal(run, Path(name) / "ledger", group, groups))
                theirs.append(sqlite(rows, Path(name) / "events.db", group, groups))
        mine, peer = (statistics.median(one.wall for one in found) for found in (ours, theirs))
        spent, peer_spent = (statistics.median(one.processor for one in found) for found in (ours, theirs))
        print(
            f"groups of {group:>5,}: {mine:>9,.0f} events/s, SQLite {peer:>9,.0f}, ratio {mine / peer:.2f} (wanted: "
            f"1); of processor time {spent:>9,.0f}, SQLite {peer_spent:>9,.0f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
