"""Measures a day of commits at one a second, through the journal, against the same events in large commits.

    python benchmarks/small_commits.py                    86,400 commits, which take minutes
    python benchmarks/small_commits.py --commits 2000     a part of a day

Each commit adds a few events of a run that goes on; runs follow one another. The ledger is compacted at the end. Both
ledgers are then opened and verified in turns. Restart is the opening of a reader and of a writer while the journal
holds as many events as it may. Printed are medians of wall time and of processor time.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import SEAL_ROWS, Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

ORIGIN = "example.org/day"
DAY, EVENTS, LARGE = 86_400, 4, 20
"""Commits of a day, events of one of them, and runs of a large commit."""
WANTED_RATIO, WANTED_RESTART_S = 1.5, 1


class Spent(NamedTuple):
    """Units: seconds of wall time, and of processor time."""

    wall: float
    processor: float

    def __str__(self) -> str:
        return f"{1_000 * self.wall:,.2f} ms, of processor time {1_000 * self.processor:,.2f} ms"


def spent(work: Callable[[], object]) -> Spent:
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return Spent(time.perf_counter() - wall, time.process_time() - processor)


def median(found: Sequence[Spent]) -> Spent:
    return Spent(statistics.median(one.wall for one in found), statistics.median(one.processor for one in found))


def some_runs(commits: int) -> list[LedgerRun]:
    """Return runs of some hundred events each, as many as these commits take."""
    found: list[LedgerRun] = []
    pieces = 0
    while pieces < commits:
        found.append(simulate_run(RunSpec(42, "fsar", "full", "door-relay", 4, len(found)), Constants()))
        pieces += -(-len(found[-1].events) // EVENTS)
    return found


def cut(run: LedgerRun) -> list[LedgerRun]:
    """Cut the run into parts of a few events."""
    return [piece(run, at, at + EVENTS) for at in range(0, len(run.events), EVENTS)]


def in_small(path: Path, runs: Sequence[LedgerRun]) -> list[Spent]:
    """Add the runs in small commits, and compact the ledger. Returns what each commit took."""
    with Writer(path, ORIGIN) as writer:
        taken = [spent(partial(writer.add, [part])) for run in runs for part in cut(run)]
        print(f"compacting: {spent(writer.compact)}")
    return taken


def in_large(path: Path, runs: Sequence[LedgerRun]) -> None:
    with Writer(path, ORIGIN) as writer:
        for at in range(0, len(runs), LARGE):
            writer.append(stage(path, runs[at : at + LARGE]))


def restart(path: Path, runs: Sequence[LedgerRun], repeats: int) -> None:
    """Print what it takes to open a ledger whose journal holds as much as it may."""
    rows = 0
    with Writer(path, ORIGIN) as writer:
        for run in runs:
            if (rows := rows + len(run.events)) > SEAL_ROWS:
                break
            for part in cut(run):
                writer.add([part])
    view = open_for_answers(path)
    print(f"restart with {view.head.size:,} events in a journal, which is sealed before {SEAL_ROWS:,}:")
    reader = median([spent(lambda: open_for_answers(path)) for _ in range(repeats)])
    writer_ = median([spent(lambda: Writer(path, ORIGIN).close()) for _ in range(repeats)])
    print(f"    a reader {reader}; a writer {writer_} (wanted: under {WANTED_RESTART_S} s)")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--commits", type=int, default=DAY)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    runs = some_runs(options.commits)
    with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as folder:
        small, large = Path(folder) / "small", Path(folder) / "large"
        taken = in_small(small, runs)
        in_large(large, runs)
        heads = [open_for_answers(path).head for path in (small, large)]
        if heads[0].root != heads[1].root or heads[0].commits < options.commits:
            raise AssertionError(f"found {heads}, expected the same events")
        print(
            f"load {os.getloadavg()[0]:.1f}, {heads[0].size:,} events in {heads[0].commits:,} commits and in "
            f"{heads[1].commits:,}"
        )
        some = max(1, len(taken) // 20)
        print(f"a commit: {median(taken[:some])} at first; {median(taken[-some:])} at last")
        paths = {small: "small", large: "large"}
        opened: dict[Path, list[Spent]] = {small: [], large: []}
        verified: dict[Path, list[Spent]] = {small: [], large: []}
        for _ in range(options.repeats):
            for path in paths:
                opened[path].append(spent(partial(open_for_answers, path)))
                verified[path].append(spent(partial(verify, path)))
        for path, name in paths.items():
            print(f"in {name} commits: opening {median(opened[path])}; verify {median(verified[path])}")
        ours, theirs = median(verified[small]), median(verified[large])
        print(
            f"verify, small by large: ratio {ours.wall / theirs.wall:.2f}, of processor time "
            f"{ours.processor / theirs.processor:.2f} (wanted: at most {WANTED_RATIO})"
        )
        restart(Path(folder) / "restart", runs, options.repeats)
    return 0


if __name__ == "__main__":
    sys.exit(main())
