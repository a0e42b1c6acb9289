"""What if: forks beside their bases, judged by the same SQL, in pairs that share every draw."""

import gc
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.errors import UsageError
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.read import Head
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.results import typed
from fsar_ledger.metrics.sides import Side, beside, sides
from fsar_ledger.runtime.changes import Changes
from fsar_ledger.runtime.experiment import BATCH_RUNS, ORIGIN
from fsar_ledger.runtime.forks import Forked

from .bases import Base, repeated

Progress = Callable[[int, int], None]

EFFECTS = """
    SELECT
        measured.metric, measured.n, measured.differing_pairs,
        measured.second_mean AS base_mean,
        measured.first_mean AS fork_mean,
        measured.mean_difference AS difference,
        CASE measured.test WHEN 'sign' THEN bounds.low WHEN 'paired t' THEN measured.ci_low END AS low,
        CASE measured.test WHEN 'sign' THEN bounds.high WHEN 'paired t' THEN measured.ci_high END AS high,
        CASE measured.test WHEN 'sign' THEN 'bootstrap' WHEN 'paired t' THEN 't' END AS interval,
        measured.test, measured.p, gains.gain
    FROM side_differences AS measured
    LEFT JOIN side_bootstrap AS bounds ON measured.metric = bounds.metric
    LEFT JOIN side_gains AS gains
        ON measured.metric = gains.metric AND gains.pools_seeds AND gains.scenario IS NULL
    WHERE measured.pools_seeds AND measured.scenario IS NULL
    ORDER BY measured.position
"""
SIDE_OF = "SELECT DISTINCT run_id, side FROM side_runs"
VALUES = """
    SELECT firsts.metric, seconds.value AS base_mean, firsts.value AS fork_mean,
        firsts.value - seconds.value AS difference
    FROM side_runs AS firsts
    INNER JOIN side_runs AS seconds ON firsts.metric = seconds.metric AND seconds.side = 'second'
    INNER JOIN metric_definitions AS definitions ON firsts.metric = definitions.metric
    WHERE firsts.side = 'first'
    ORDER BY definitions.position
"""


class Pair(NamedTuple):
    """A base and its fork."""

    base: Base
    fork: Forked


class Effect(msgspec.Struct, frozen=True, kw_only=True):
    """The effect of the changes on one metric: fork minus base, in the metric's unit, over `n` pairs.

    In `differing_pairs` of them the metric differs. `low`, `high`: a 95 % interval, by `interval`: `t` (Student, with
    one degree of freedom less than pairs differ; for a share of runs, Bonett and Price) or `bootstrap` where few pairs
    differ. `test` is `paired t` or the exact `sign` test. `gain`: so many times as many independent runs would give the
    same precision.
    None: what one pair or equal pairs do not have; means where the metric is undefined.
    """

    metric: str
    n: int
    differing_pairs: int
    base_mean: float | None
    fork_mean: float | None
    difference: float | None
    low: float | None = None
    high: float | None = None
    interval: str | None = None
    test: str | None = None
    p: float | None = None
    gain: float | None = None


class Effects(msgspec.Struct, frozen=True, kw_only=True):
    """The effects on the runs of one architecture and configuration: pairs, how many of them part, and each metric."""

    architecture: str | None
    configuration: str | None
    pairs: int
    diverging: int
    rows: list[Effect]


def forked(bases: Iterable[Base], changes: Changes, count: int, progress: Progress | None = None) -> list[Pair]:
    """Return the fork of each base; what a name does not mean in a run changes nothing there.

    Args:
        bases: The runs.
        changes: What is otherwise.
        count: How many bases there are.
        progress: Called with the forks that were played, and their number.

    Raises:
        UsageError: A base cannot be made again, or a change is impossible there.
    """
    found: list[Pair] = []
    with without_collection():
        for base in bases:
            found.append(Pair(base, repeated(base).fork(changes)))
            if progress is not None:
                progress(len(found), count)
    return found


@contextmanager
def without_collection() -> Iterator[None]:
    """Collect no garbage inside: a run makes no cycles."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def effects(pairs: Sequence[Pair]) -> list[Effects]:
    """Judge the pairs by every metric, for each architecture and configuration of the bases, in order.

    Raises: as `Database.rows`.
    """
    with from_table(encode([record for pair in pairs for record in (pair.base.record, pair.fork.record)])) as database:
        side_of = {row["run_id"]: row["side"] for row in database.rows(SIDE_OF)}
        held = {one.side: one for one in sides(database)}
        groups: dict[tuple[str, str], list[Pair]] = {}
        for pair in pairs:
            both = side_of[pair.base.record.run_id], side_of[pair.fork.record.run_id]
            groups.setdefault(both, []).append(pair)
        return [_effects(database, held[base], held[fork], group) for (base, fork), group in groups.items()]


def _effects(held: Database, base: Side, fork: Side, group: Sequence[Pair]) -> Effects:
    with beside([held], (fork, base)) as database:
        if len(group) > 1:
            rows = typed(database.rows(EFFECTS), Effect)
        else:
            rows = typed([_of_one(row) for row in database.rows(VALUES)], Effect)
    return Effects(
        architecture=base.architecture,
        configuration=base.configuration,
        pairs=len(group),
        diverging=sum(pair.fork.parts_at is not None for pair in group),
        rows=rows,
    )


def _of_one(row: dict[str, Any]) -> dict[str, Any]:
    differs = row["base_mean"] != row["fork_mean"]
    return {**row, "n": 1, "differing_pairs": int(differs)}


def keep(out: Path, pairs: Sequence[Pair], progress: Progress | None = None) -> Head:
    """Commit each base and its fork to a ledger, which is created if there is none; return its head.

    What it holds already is left out.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError, WriteFailed: See `Writer`.
    """
    with Writer(out, ORIGIN) as writer:
        held = {*writer.held().runs}
        records: list[LedgerRun] = []
        for pair in pairs:
            for record in (pair.base.record, pair.fork.record):
                if record.run_id not in held:
                    held.add(record.run_id)
                    records.append(record)
        for begin in range(0, len(records), BATCH_RUNS):
            writer.append(stage(out, records[begin : begin + BATCH_RUNS]))
            if progress is not None:
                progress(min(begin + BATCH_RUNS, len(records)), len(records))
        return writer.head


def simulated(records: Iterable[LedgerRun]) -> Iterator[LedgerRun]:
    """Yield the runs that were simulated and do not fork from another. Raises: UsageError if there is none."""
    is_there = False
    for record in records:
        started = record.events[0]
        if isinstance(started, RunStarted) and started.kind == "simulated" and started.changes is None:
            is_there = True
            yield record
    if not is_there:
        raise UsageError("found no simulated run that is not a fork itself, expected some to fork from")
