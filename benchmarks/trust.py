"""Measures the cost of trust: verifying against hashing alone, hashing and its tree against simulating; prints ratios.

python benchmarks/trust.py              2.8 million events
python benchmarks/trust.py --runs 20    a small run
"""

import argparse
import hashlib
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.metrics import experiment
from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical, codec
from fsar_ledger.ledger.rows.segment import read_table
from fsar_ledger.ledger.store import append
from fsar_ledger.ledger.store.paths import CHAIN
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions
from fsar_ledger.runtime.experiment import run_experiment


def leaf_bytes(view: View) -> list[list[bytes]]:
    """Return the canonical bytes of all rows, each after its 0x00, by segment."""
    return [canonical.from_table(read_table(path)) for path in view.segments()]


def hash_and_read(view: View, rows: list[list[bytes]]) -> None:
    """Hash the same leaf bytes with hashlib and read the same rows from Parquet, as the alternative, on one core."""
    for lines in rows:
        for line in lines:
            hashlib.sha256(line).digest()
    for path in view.segments():
        pq.read_table(path, use_threads=False)


def hash_files(ledger: Path) -> None:
    """Hash the records and segments with hashlib, as the alternative to `verify --quick`, on one core."""
    for path in [ledger / CHAIN, *(ledger / "segments").iterdir()]:
        with path.open("rb") as file:
            hashlib.file_digest(file, "sha256").hexdigest()


def ratio(work: Callable[[], object], alternative: Callable[[], object], repeats: int) -> tuple[float, float, float]:
    """Return the median of the paired ratios, and the best seconds of each side."""
    pairs = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        between = time.perf_counter()
        alternative()
        pairs.append((between - began, time.perf_counter() - between))
    return (
        statistics.median(one / other for one, other in pairs),
        min(one for one, _ in pairs),
        min(other for _, other in pairs),
    )


class Clock:
    """A clock of the functions that it wraps; time in a wrapped function within another counts once."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._depth = 0

    def wrap(self, holder: Any, name: str) -> Callable[[], None]:
        """Time the function until the returned one is called."""
        original = getattr(holder, name)

        def timed(*arguments: Any, **named: Any) -> Any:
            self._depth += 1
            began = time.perf_counter()
            try:
                return original(*arguments, **named)
            finally:
                self._depth -= 1
                if not self._depth:
                    self.seconds += time.perf_counter() - began

        setattr(holder, name, timed)
        return lambda: setattr(holder, name, original)


def share_of_simulate(folder: Path, runs: int) -> float:
    """Return the share of a one-core simulation spent on leaves, the tree, its nodes and the checkpoint."""
    clock = Clock()
    undo = [
        clock.wrap(codec._Rows, "leaves"),
        clock.wrap(pack, "grow"),
        clock.wrap(append, "append_derived"),
        clock.wrap(append.Writer, "_write_checkpoint"),
    ]
    began = time.perf_counter()
    run_experiment(folder, experiment(runs), 1, None)
    seconds = time.perf_counter() - began
    for one in undo:
        one()
    return clock.seconds / seconds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=340, help="for each scenario and architecture")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2, help="of verify, where it says so")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        ledger = Path(temporary) / "ledger"
        run_experiment(ledger, experiment(arguments.runs), arguments.workers, None)
        view = open_ledger(ledger)
        rows = leaf_bytes(view)
        print(f"{view.head.size:,} events in {view.head.commits} commits")
        cases: tuple[tuple[str, Callable[[], object], str, Callable[[], object], float], ...] = (
            (
                f"verify, {arguments.workers} processes",
                lambda: verify(ledger, arguments.workers),
                "hashlib + read",
                lambda: hash_and_read(view, rows),
                2.5,
            ),
            ("verify, 1 process", lambda: verify(ledger), "hashlib + read", lambda: hash_and_read(view, rows), 2.5),
            (
                "verify --quick",
                lambda: verify(ledger, 1, None, VerifyOptions(is_quick=True)),
                "hashlib",
                lambda: hash_files(ledger),
                1.5,
            ),
        )
        for name, work, other, alternative, target in cases:
            found, seconds, other_seconds = ratio(work, alternative, arguments.repeats)
            print(f"{name:22} {seconds:7.3f} s   {other:15} {other_seconds:7.3f} s   ", end="")
            print(f"ratio {found:5.2f}   (target {target})")
        share = share_of_simulate(Path(temporary) / "again", min(arguments.runs, 40))
        print(f"hashing and nodes: {share:.0%} of simulate's time on one core   (target 30%)")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
