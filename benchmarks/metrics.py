"""Measures the eight metrics over 10 million events, against the same aggregation written in Polars; prints the ratio.

    python benchmarks/metrics.py                    10 million events; the ledger is simulated once and kept
    python benchmarks/metrics.py --events 200000    a small run
    python benchmarks/metrics.py --ledger out/ledger   a ledger of yours

Both sides start from the segment files of a ledger, use every core, and must give the same numbers; ours knows nothing
of the ledger from before. Printed are medians of wall time and of CPU seconds.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import polars as pl

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.polars_metrics import GROUP, PRINCIPALS, EventClasses, eight_metrics
from benchmarks.table import note
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.simulation import SCENARIOS, run_id, run_started

TOLERANCE = 1e-9


class Spent(NamedTuple):
    """Units: seconds of wall time, and of all processors."""

    wall: float
    cpu: float


Numbers = dict[tuple[str | None, str | None, int | None, str], float]


def ledger_of(events: int, cache: Path, workers: int) -> Path:
    """Return a ledger with about this many events: five scenarios, three architectures, as many runs as needed."""
    with tempfile.TemporaryDirectory() as probe:
        per_run = run_experiment(Path(probe) / "probe", experiment(4), workers, None).head.size / (15 * 4)
    runs = max(4, round(events / per_run / 15))
    model = run_id(run_started(next(experiment(1).specs()), Constants()))[-12:]  # a changed model gets its own cache
    ledger = cache / f"runs-{runs}-{model}"
    print(f"ledger of {runs} runs per scenario and architecture: {ledger}", flush=True)
    run_experiment(ledger, experiment(runs), workers, None)
    return ledger


def experiment(runs: int) -> Experiment:
    return Experiment(
        architectures=PAPER_ARCHITECTURES,
        scenarios=SCENARIOS,
        runs=runs,
        seed=42,
        fleet_size=4,
        configurations=("full",),
    )


def by_sql(ledger: Path) -> Numbers:
    with (
        tempfile.TemporaryDirectory() as cache,
        patch.dict(os.environ, XDG_CACHE_HOME=cache),
        connect(ledger) as database,
    ):
        published = {row["metric"] for row in database.rows("SELECT metric FROM metric_definitions WHERE is_published")}
        return {
            (row.architecture, row.configuration, row.fleet_size, row.metric): row.mean
            for row in metric_rows(database)
            if row.mean is not None and row.metric in published
        }


def event_classes(ledger: Path) -> EventClasses:
    with connect(ledger) as database:
        rows = database.rows("SELECT * FROM event_classes")
    return EventClasses(
        judged=[row["type"] for row in rows],
        decisions=[row["type"] for row in rows if row["decision_kind"]],
        denials=[row["type"] for row in rows if row["decision_kind"] == "denial"],
        records=[row["type"] for row in rows if row["record_kind"]],
        of_requesters=[row["type"] for row in rows if row["part"] == "requester"],
        requiring={
            principal: [row["type"] for row in rows if row[f"requires_{word}"]]
            for principal, word in zip(PRINCIPALS, ("origin", "executor", "supervisor"), strict=True)
        },
    )


def by_polars(events: pl.LazyFrame, classes: EventClasses) -> Numbers:
    rows = eight_metrics(events, classes).to_dicts()
    return {
        (row["architecture"], row["configuration"], row["fleet_size"], metric): value
        for row in rows
        for metric, value in row.items()
        if metric not in GROUP and value is not None
    }


def timed(work: Callable[[], Numbers]) -> tuple[Spent, Numbers]:
    began, cpu = time.perf_counter(), time.process_time()
    numbers = work()
    return Spent(time.perf_counter() - began, time.process_time() - cpu), numbers


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--events", type=int, default=10_000_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2, help="processes that simulate the ledger")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "fsar-ledger-benchmark")
    parser.add_argument("--ledger", type=Path, help="a ledger to measure, instead of one that is simulated")
    options = parser.parse_args()
    ledger = options.ledger or ledger_of(options.events, options.cache, options.workers)
    view = open_ledger(ledger)
    segments, classes = view.segments(), event_classes(ledger)
    sql_s: list[Spent] = []
    polars_s: list[Spent] = []
    for _ in range(options.repeats):  # in turn, so that a slow moment of the machine hits both
        seconds, ours = timed(lambda: by_sql(ledger))
        sql_s.append(seconds)
        seconds, theirs = timed(lambda: by_polars(pl.scan_parquet(segments), classes))
        polars_s.append(seconds)
        differing = sorted(
            key
            for key in ours.keys() | theirs.keys()
            if abs(ours.get(key, float("inf")) - theirs.get(key, float("-inf"))) > TOLERANCE
        )
        if differing:
            for key in differing:
                print(f"differs: {key}: SQL {ours.get(key)}, Polars {theirs.get(key)}", file=sys.stderr)
            return 1
    sql, polars = (statistics.median(one.wall for one in found) for found in (sql_s, polars_s))
    sql_cpu, polars_cpu = (statistics.median(one.cpu for one in found) for found in (sql_s, polars_s))
    print(f"events                  {view.head.size:>12,}")
    million_per_s = view.head.size / sql / 1e6
    print(f"eight metrics, SQL      {sql:>12.2f} s   (with summary, intervals and start-up; ", end="")
    print(f"{million_per_s:.1f} million events/s)")
    print(f"eight metrics, Polars   {polars:>12.2f} s   (means only)")
    print(f"same numbers            {len(ours):>12} of {len(ours)} within {TOLERANCE}")
    print(f"SQL / Polars            {sql / polars:>12.2f}     (target: at most 2)")
    print(f"CPU seconds             {sql_cpu:>12.2f}     Polars {polars_cpu:.2f}, ratio {sql_cpu / polars_cpu:.2f}")
    note(
        f"eight metrics, {view.head.size:,} events",
        f"{sql_cpu:.1f} CPU s",
        f"hand-written Polars, means only: {polars_cpu:.1f} CPU s; ratio {sql_cpu / polars_cpu:.2f}",
        "5 CPU s at 10 million",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
