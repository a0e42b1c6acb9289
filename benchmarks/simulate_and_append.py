"""Measures events per second from world to durable, hashed ledger, against stores of finished events.

    python benchmarks/simulate_and_append.py             the paper's 300 runs
    python benchmarks/simulate_and_append.py --runs 4    a small run

Ours simulates, encodes, checks, hashes and commits. The peers of `peers.py` begin at the world, too: the same runs are
simulated and stored as they come, without checks and hashes. Beside it all stores alone, ours and theirs, which are
given finished events. Each measurement has a process of its own, which has imported what it needs when the clock
starts. They take turns; printed are medians.
"""

import argparse
import gc
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.peers import Measurement, apart, cpu_rate, eventsourcing_saves, measured, sqlite_saves, wall_rate
from benchmarks.table import note
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import ORIGIN, Experiment, run_experiment
from fsar_ledger.runtime.simulation import SCENARIOS, simulate_run

RUNS_AT_ONCE = 30  # some 16,000 events, as in a commit


def experiment(runs: int) -> Experiment:
    return Experiment(architectures=PAPER_ARCHITECTURES, scenarios=SCENARIOS, runs=runs)


def playing(runs: int) -> Iterator[LedgerRun]:
    """Play the experiment, run by run."""
    constants = Constants()
    return (simulate_run(spec, constants) for spec in experiment(runs).specs())


def made(runs: int) -> list[LedgerRun]:
    """Return the finished events of the experiment."""
    return list(playing(runs))


def encoded(runs: Iterator[LedgerRun]) -> Iterator[bytes]:
    """Yield the canonical bytes of the rows of these runs, encoded so many runs at a time as suits the encoder."""
    while some := list(islice(runs, RUNS_AT_ONCE)):
        yield from encode_lines(some)


def world_to_ledger(folder: Path, runs: int, workers: int) -> Measurement:
    """Measure from world to committed ledger; with two workers, the start of their processes is counted."""
    with tempfile.TemporaryDirectory(dir=folder) as warm:  # everything is imported now
        run_experiment(Path(warm) / "ledger", experiment(1), 1)
    with tempfile.TemporaryDirectory(dir=folder) as place:
        return measured(lambda: run_experiment(Path(place) / "ledger", experiment(runs), workers).head.size)


def our_store(folder: Path, runs: int) -> Measurement:
    """Measure from finished events to committed ledger."""
    found = made(runs)

    def store(place: Path, parts: Sequence[LedgerRun]) -> int:
        with Writer(place, ORIGIN, None) as writer:
            for at in range(0, len(parts), RUNS_AT_ONCE):
                writer.append(stage(place, parts[at : at + RUNS_AT_ONCE]))
            return writer.head.size

    with tempfile.TemporaryDirectory(dir=folder) as place:
        store(Path(place) / "warm", found[:2])
        return measured(lambda: store(Path(place) / "ledger", found))


def eventsourcing_store(folder: Path, runs: int, plays: bool) -> Measurement:
    """Measure `eventsourcing` from finished events or, as ours, from the world."""
    found = made(1 if plays else runs)
    with tempfile.TemporaryDirectory(dir=folder) as place:
        eventsourcing_saves(found[:2], Path(place) / "warm.db")
        gc.disable()  # as ours while it simulates
        return measured(lambda: eventsourcing_saves(playing(runs) if plays else found, Path(place) / "events.db"))


def sqlite_store(folder: Path, runs: int, begins: str) -> Measurement:
    """Measure SQLite from finished `bytes`; from finished `events`, which we encode for it; or from the `world`."""
    found = made(1 if begins == "world" else runs)
    rows = encode_lines(found if begins == "bytes" else found[:2])  # else to be warm
    with tempfile.TemporaryDirectory(dir=folder) as place:
        gc.disable()
        given: dict[str, Callable[[], Iterable[bytes]]] = {
            "bytes": lambda: rows,
            "events": lambda: encoded(iter(found)),
            "world": lambda: encoded(playing(runs)),
        }
        return measured(lambda: sqlite_saves(given[begins](), Path(place) / "events.db"))


def compare(found: dict[str, list[Measurement]]) -> None:
    """Print how ours stand to the best peer: from the world, and the stores alone."""
    ours, store = wall_rate(found["ours"]), wall_rate(found["store"])
    whole = ours / max(wall_rate(found[key]) for key in ("eventsourcing", "SQLite"))
    alone = store / max(wall_rate(found[f"{key}'s store"]) for key in ("eventsourcing", "SQLite"))
    print(f"world to durable / the best peer        {whole:>11.2f} (wanted: more than 1.5)")
    print(f"our store / the best store              {alone:>11.2f}")
    peers = ", ".join(f"{key} {cpu_rate(found[key]):,.0f}" for key in ("eventsourcing", "SQLite"))
    note(
        "world to durable, hashed ledger, one core",
        f"{cpu_rate(found['ours']):,.0f} events/CPU s, {ours:,.0f}/s; our store alone {cpu_rate(found['store']):,.0f}",
        f"{peers} from the world, no hashes; ours / the best, wall time {whole:.2f}; of the stores alone {alone:.2f}",
        "250,000/s; 1.5 times the best peer",
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=20, help="runs per scenario and architecture")
    parser.add_argument("--scaling-runs", type=int, default=None, help="for one worker against two; 8 times as many")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    runs = options.runs
    scaling_runs = options.scaling_runs or 8 * runs
    found: dict[str, list[Measurement]] = {}
    with tempfile.TemporaryDirectory(prefix="fsar-ledger-") as name:
        folder = Path(name)
        for turn in range(options.repeats):  # in turn, so that a slow moment of the machine hits all
            for key, measurement in (
                ("ours", apart(world_to_ledger, folder, runs, 1)),
                ("store", apart(our_store, folder, runs)),
                ("eventsourcing", apart(eventsourcing_store, folder, runs, True)),
                ("SQLite", apart(sqlite_store, folder, runs, "world")),
                ("eventsourcing's store", apart(eventsourcing_store, folder, runs, False)),
                ("SQLite's store", apart(sqlite_store, folder, runs, "events")),
                ("bytes", apart(sqlite_store, folder, runs, "bytes")),
                ("one", apart(world_to_ledger, folder, scaling_runs, 1)),
                ("two", apart(world_to_ledger, folder, scaling_runs, 2)),
            ):
                found.setdefault(key, []).append(measurement)
            print(f"turn {turn + 1}: load {os.getloadavg()[0]:.1f}", flush=True)
        run_experiment(folder / "ledger", experiment(runs), 1)
        view = open_ledger(folder / "ledger")
        segments = sum(path.stat().st_size for path in view.segments())
    print(f"events                                  {found['ours'][0].events:>11,}")
    print("                                          of wall time   of processor time")
    for key, what in (
        ("ours", "world to durable, hashed ledger"),
        ("eventsourcing", "world to durable, eventsourcing"),
        ("SQLite", "world to durable, SQLite WAL FULL"),
        ("store", "our store alone, finished events"),
        ("eventsourcing's store", "eventsourcing, finished events"),
        ("SQLite's store", "SQLite WAL FULL, finished events"),
        ("bytes", "SQLite WAL FULL, finished bytes"),
    ):
        print(f"{what:<38}  {wall_rate(found[key]):>10,.0f}/s        {cpu_rate(found[key]):>10,.0f}/s")
    compare(found)
    one, two = wall_rate(found["one"]), wall_rate(found["two"])
    note("two workers / one", f"{two / one:.2f}", "one worker", "1.9")
    print(
        f"two workers / one                       {two / one:>11.2f} (wanted: 1.9; {found['one'][0].events:,} events)"
    )
    small, large = (max(run.peak_mib for run in found[key]) for key in ("ours", "one"))
    print(f"peak memory of a process                {large:>7.0f} MiB, {small:.0f} with fewer runs")
    print(f"bytes per event in segments             {segments / found['ours'][0].events:>11.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
