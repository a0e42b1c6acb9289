"""Measures what a question about one run costs in a ledger of ten million events, against one of a hundred thousand.

    python benchmarks/one_run.py                100,000 and 10,000,000 events, which takes minutes to make
    python benchmarks/one_run.py --runs 12 120  another pair of sizes, in runs of each scenario
    python benchmarks/one_run.py --cache DIR    the ledgers are kept in DIR, and copied from there the next time

Asked of each in turns: prove an event, list the requests of a run, tell a run, how it stood, and
append one run. Each time it is a run of another scenario and architecture, the same run in both ledgers: the one in the
middle of these in the smaller ledger. Printed are the medians of wall time and of processor time, and of the
differences.
"""

import argparse
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import fsar_ledger
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import ORIGIN
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

WANTED_MS = 20


def middle_runs(path: Path) -> list[str]:
    """Return the run in the middle of each scenario and architecture of a ledger."""
    kinds: dict[str, list[str]] = {}
    for name in open_for_answers(path).run_names.runs:
        kinds.setdefault(name.partition(".n4.")[0], []).append(name)
    return [names[len(names) // 2] for _, names in sorted(kinds.items())]


def questions(path: Path, runs: Sequence[str]) -> dict[str, Callable[[int], object]]:
    """Return what is asked of a ledger about these runs; the number tells repeats apart."""
    ledger = fsar_ledger.Ledger(path)

    def run(number: int) -> str:
        return runs[number % len(runs)]

    def append(number: int) -> object:
        made = simulate_run(RunSpec(1_000_000 + number, "fsar", "full", "door-relay", 4, 0), Constants())
        with Writer(path, ORIGIN) as writer:
            return writer.append(stage(path, [made]))

    return {
        "prove": lambda number: ledger.prove(f"{run(number)}:5"),
        "requests": lambda number: ledger.requests(run(number)),
        "log": lambda number: ledger.log(run(number)),
        "state": lambda number: ledger.state(run(number), 20),
        "append": append,
    }


def make(path: Path, runs: int, cache: Path | None) -> None:
    """Make a ledger with this many runs of each scenario, or copy it from the cache, which is filled first."""
    kept = path if cache is None else cache / f"{runs}"
    if not kept.exists():
        fsar_ledger.simulate(kept, runs=runs, seed=42)
    if kept != path:
        shutil.copytree(kept, path)


def medians(small: Sequence[float], large: Sequence[float]) -> tuple[float, float, float]:
    """Return the median of each, and of the differences, without the first, which fills the caches."""
    more = [other - one for one, other in zip(small, large, strict=True)]
    return statistics.median(small[1:]), statistics.median(large[1:]), statistics.median(more[1:])


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, nargs=2, default=(12, 1227), help="of each scenario, in the two ledgers")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--cache", type=Path, help="a folder that keeps the ledgers")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as folder:
        paths = []
        for runs in options.runs:
            path = Path(folder) / f"{runs}"
            make(path, runs, options.cache)
            head = open_for_answers(path).head
            print(f"{runs:,} runs of each scenario: {head.size:,} events in {head.commits:,} commits")
            paths.append(path)
        asked = [questions(path, middle_runs(paths[0])) for path in paths]
        print(f"load {os.getloadavg()[0]:.1f}")
        for name in asked[0]:
            taken: tuple[list[float], list[float]] = ([], [])
            spent: tuple[list[float], list[float]] = ([], [])
            for number in range(options.repeats + 1):
                for walls, processors, one in zip(taken, spent, asked, strict=True):
                    wall, processor = time.perf_counter(), time.process_time()
                    one[name](number)
                    walls.append(1_000 * (time.perf_counter() - wall))
                    processors.append(1_000 * (time.process_time() - processor))
            small, large, more = medians(*taken)
            least, most, further = medians(*spent)
            print(
                f"{name:>8}: {small:6.1f} ms, {large:6.1f} ms, {more:+6.1f} (wanted: at most {WANTED_MS}); of "
                f"processor time {least:6.1f} ms, {most:6.1f} ms, {further:+6.1f}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
