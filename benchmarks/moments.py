"""How long a moment of a long run takes, beside folding the run from its beginning.

The run has a fleet of 32 robots; it is repeated, one copy after the other, until it has as many events as asked for.

    python benchmarks/moments.py --events 1000000
"""

import argparse
import os
import statistics
import time
from random import Random

from fsar_ledger.analysis.moments import EVERY, Timeline
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.simulation import RunSpec, simulate_run


def long_run(events: int) -> LedgerRun:
    one = simulate_run(RunSpec(42, "fsar", "full", "fleet-contention", 32, 0), Constants())
    founding = sum(time_us == 0 for time_us in one.times_us)
    turns = range(max(1, events // len(one.events)))
    times_us, causes, found = [*one.times_us], [*one.caused_by], [*one.events]
    for turn in turns[1:]:
        times_us += [time_us + turn * one.times_us[-1] for time_us in one.times_us[founding:]]
        causes += one.caused_by[founding:]
        found += one.events[founding:]
    return LedgerRun("long", times_us, causes, found)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--events", type=int, default=1_000_000)
    run = long_run(parser.parse_args().events)
    begun = time.perf_counter()
    timeline = Timeline(run)
    built = time.perf_counter() - begun
    draw = Random(1)
    took = []
    for _ in range(200):
        seq = draw.randrange(len(run.events))
        begun = time.perf_counter()
        timeline.past(seq)
        took.append(time.perf_counter() - begun)
    begun = time.perf_counter()
    fold(run.events)
    folded = time.perf_counter() - begun
    load = os.getloadavg()[0]
    print(f"{len(run.events):,} events, a state kept every {EVERY}; load {load:.1f}")
    print(f"built in {built:.2f} s, {built / folded:.2f} of one fold ({folded:.2f} s)")
    print(
        f"a moment: median {statistics.median(took) * 1e3:.2f} ms, most {max(took) * 1e3:.2f} ms, "
        f"{statistics.median(took) / (folded / 2):.5f} of folding half the run"
    )


if __name__ == "__main__":
    main()
