"""What if: forks beside their bases, judged by the same SQL, in pairs that share every draw."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.base.errors import SequenceConflict, UsageError, option
from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.progress import parts_of
from fsar_ledger.base.workers import pool_of
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.locations import earlier_runs, records_of
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.comparison_sides import beside
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.results import typed
from fsar_ledger.runtime.change_texts import parsed, read_changes
from fsar_ledger.runtime.changes import MODEL, Changes
from fsar_ledger.runtime.experiment import ORIGIN
from fsar_ledger.runtime.forks import Fork
from fsar_ledger.runtime.live import SOURCE

from . import starts_of
from .fork_base import Base, Refusal, base_of_record, refusal, rerun

EVENTS_AT_ONCE = 200_000
"""Events of pairs judged together."""
BATCH_RUNS = 25  # runs in a commit

RUNS = """
    SELECT
        to_json([architecture, configuration, setting])::VARCHAR AS side, run_id, architecture, configuration, setting,
        fleet_size, kind, model_version, seed, scenario, run, 1::BIGINT AS twins, TRUE AS observes_world,
        NULL::VARCHAR AS world_sha256, metric, value, numerator, denominator
    FROM run_metrics
    ORDER BY run_id, metric
"""
"""The rows of `side_runs`, without what only pairs of runs from different worlds need."""
EFFECTS = """
    SELECT
        definitions.metric,
        coalesce(measured.n, 0) AS n, coalesce(measured.differing_pairs, 0) AS differing_pairs,
        measured.second_mean AS base_mean, measured.first_mean AS fork_mean, measured.mean_difference AS difference,
        measured.ci_low AS low, measured.ci_high AS high, measured.test, measured.p, gains.gain
    FROM metric_definitions AS definitions
    LEFT JOIN side_differences AS measured
        ON definitions.metric = measured.metric AND measured.pools_seeds AND measured.scenario IS NULL
    LEFT JOIN side_gains AS gains
        ON definitions.metric = gains.metric AND gains.pools_seeds AND gains.scenario IS NULL
    ORDER BY definitions.position
"""
VALUES = """
    SELECT
        firsts.metric, seconds.value AS base_mean, firsts.value AS fork_mean,
        firsts.value - seconds.value AS difference,
        (if(definitions.is_pooled, firsts.numerator + seconds.numerator, difference) IS NOT NULL)::BIGINT AS n,
        coalesce(
            if(
                definitions.is_pooled,
                firsts.numerator <> seconds.numerator OR firsts.denominator <> seconds.denominator,
                round(difference * 1e9) <> 0
            ),
            FALSE
        )::BIGINT AS differing_pairs
    FROM side_runs AS firsts
    INNER JOIN side_runs AS seconds ON firsts.metric = seconds.metric AND seconds.side = 'second'
    INNER JOIN metric_definitions AS definitions ON firsts.metric = definitions.metric
    WHERE firsts.side = 'first'
    ORDER BY definitions.position
"""
UNKNOWN = {"fork_mean": None, "difference": None, "n": 0, "differing_pairs": 0}
"""The effect in a fork that ends before all has happened."""


class Pair(NamedTuple):
    """A base, its fork, and the refusal of changes there, if any."""

    base: Base
    fork: Fork
    refused: Refusal | None = None

    @property
    def records(self) -> tuple[LedgerRun, LedgerRun]:
        """Return the records of both."""
        return self.base.record, self.fork.record


class Divergence(msgspec.Struct, frozen=True):
    """A base and its fork by name, and the first seq and time at which they differ; None: they do the same.

    `ends_s`: when the fork of a live run ends before all has happened, `ends` why, and `question` what an `answer` to
    it would name; None: it does not end there. `left_out`: commands on record that would not have been given in it.
    `refused`: why a change is refused there, such as a rejected command; a fork that differs only in that is the same.
    Units: seconds of run time.
    """

    base: str
    fork: str
    parts_at: int | None
    parted_s: float | None
    ends_s: float | None = None
    ends: str | None = None
    question: str | None = None
    left_out: tuple[str, ...] = ()
    refused: str | None = None


class RefusedChange(msgspec.Struct, frozen=True):
    """Why a change is refused, and in how many pairs."""

    reason: str
    pairs: int


class Effect(msgspec.Struct, frozen=True, kw_only=True):
    """The effect of the changes on one metric: fork minus base, in the metric's unit.

    The means are over `n` pairs, those in which both have it or, of a ratio over all pairs, record it; in
    `differing_pairs` of them it differs. `low`, `high` (95 %), `test` (`paired t` or the exact `sign` test) and `p` are
    those of `compare` (`statistics/side_differences`). `gain`: as `statistics/side_gains`.
    None: what one pair or equal pairs do not have; means where the metric is undefined, of several also where `n` is 0.
    """

    metric: str
    n: int
    differing_pairs: int
    base_mean: float | None
    fork_mean: float | None
    difference: float | None
    low: float | None = None
    high: float | None = None
    test: str | None = None
    p: float | None = None
    gain: float | None = None


class Effects(msgspec.Struct, frozen=True, kw_only=True):
    """The effects on the runs of one side of `compare`: pairs, how many of them diverge, and each metric.

    `side` is its name there, `fsar:full@A/4`; None: of a single run. `refused`: why, and in how many of the pairs, a
    change is refused.
    """

    architecture: str | None
    configuration: str | None
    pairs: int
    diverging: int
    refused: list[RefusedChange]
    rows: list[Effect]
    side: str | None = None


def forks_of(bases: Iterable[Base], changes: Changes) -> Iterator[Pair]:
    """Yield each base with its fork; a name that matches nothing in a run changes nothing there.

    Raises:
        UsageError: A base cannot be made again, or a change is impossible there.
    """
    for base in bases:
        repeated = rerun(base)
        try:
            fork = repeated.checked_fork(changes)
        except UsageError as error:
            raise UsageError(f"{error}{of_run(base.record.run_id)}") from error
        yield Pair(base, fork, refusal(repeated, changes, fork))


def of_run(run: str, others: str = "") -> str:
    """Return the end of an error message: the run that it is about, and what is true of the others."""
    return f"; that is run {printable.value(run)}{', and ' if others else ''}{others}"


def refused_in_all(pairs: Sequence[tuple[str, str]]) -> UsageError:
    """Return the error of changes that are refused in every run, given each run and why."""
    (run, why), count = pairs[0], len(pairs)
    return UsageError(f"{why}{of_run(run, f'some change is refused in each of {count:,} runs' if count > 1 else '')}")


def refused_in(pairs: Iterable[str | None]) -> list[RefusedChange]:
    """Return the reasons for which changes are refused, each with its number of pairs, the most frequent first."""
    return [RefusedChange(reason, count) for reason, count in Counter(filter(None, pairs)).most_common()]


def effects(pairs: Iterable[Pair]) -> tuple[list[Divergence], list[Effects]]:
    """Judge the pairs by every metric, for each architecture and configuration of the bases, in order.

    They are judged in batches, so that memory does not grow with their number.

    Raises: as `Database.rows`, and as what yields the pairs.
    """
    return _compared([_judged(pairs)])


def effects_over(
    view: View,
    runs: Sequence[str],
    changes: Changes,
    names: Mapping[str, str],
    progress: Callable[[int], None] | None,
) -> tuple[list[Divergence], list[Effects]]:
    """Fork these runs of a ledger, on a cluster if there is one, and judge the pairs as `effects` does.

    `names` are those of the sides, by the column `side` of `sides`. `progress` is called with the number of forks
    played.

    Raises: as `fork_pairs` and `Database.rows`; SequenceConflict if another process finds a different ledger there.
    """
    parts = _parts(view, runs)
    path, root, judged = str(view.path.absolute()), view.head.root, list[_JudgedPairs]()
    with pool_of(1) as pool:
        for part in (pool.map if pool else map)(_forked, repeat(path), repeat(root), parts, repeat(changes)):
            judged.append(part)
            if progress is not None:
                progress(sum(len(divergences) for divergences, _ in judged))
    return _compared(judged, names)


def _forked(ledger: str, root: str, runs: Sequence[str], changes: Changes) -> "_JudgedPairs":
    """Fork these runs of the ledger with this root, and judge the pairs. Raises: as `effects_over`."""
    view = open_for_answers(Path(ledger))
    if view.head.root != root:
        raise SequenceConflict(
            f"{ledger}: found root {view.head.root} where another process found {root}, expected the same; check that "
            "it is the same folder there, and run it again if it has grown"
        )
    return _judged(fork_pairs(view, runs, changes))


_JudgedPairs = tuple[list[Divergence], list[pa.Table]]
"""Where pairs diverge, and the metrics of both runs of each."""


def _judged(pairs: Iterable[Pair]) -> _JudgedPairs:
    parted: list[Divergence] = []
    rows: list[pa.Table] = []
    with without_collection():
        for batch in parts_of(pairs, lambda pair: sum(len(run.events) for run in pair.records), EVENTS_AT_ONCE):
            parted += map(_divergence, batch)
            with from_table(encode_coded([run for pair in batch for run in pair.records])) as database:
                rows.append(database.table(RUNS))
    return parted, rows


def _compared(judged: Iterable[_JudgedPairs], names: Mapping[str, str] = {}) -> tuple[list[Divergence], list[Effects]]:
    parted: list[Divergence] = []
    rows: list[pa.Table] = []
    for divergences, tables in judged:
        parted += divergences
        rows += tables
    if not rows:
        return parted, []
    measured = pa.concat_tables(rows)
    side_of = dict(zip(measured.column("run_id").to_pylist(), measured.column("side").to_pylist(), strict=True))
    groups: dict[tuple[str, str], list[Divergence]] = {}
    for divergence in parted:
        groups.setdefault((side_of[divergence.base], side_of[divergence.fork]), []).append(divergence)
    by_base = [(base, _effects(measured, base, fork, group)) for (base, fork), group in groups.items()]
    return parted, [msgspec.structs.replace(effect, side=names.get(base)) for base, effect in by_base]


def _divergence(pair: Pair) -> Divergence:
    (base, fork), refused = pair.records, pair.refused
    seq = None if refused is not None and refused.is_same else pair.fork.parts_at
    why = None if refused is None else refused.why
    times = [] if seq is None else [run.times_us[seq] for run in pair.records if seq < len(run.times_us)]
    parted_s = min(times) / 1e6 if times else None
    left_out = tuple(f"{command.command} of {command.issued_by}" for command in pair.fork.left_out)
    end = pair.fork.end
    if end is None:
        return Divergence(base.run_id, fork.run_id, seq, parted_s, left_out=left_out, refused=why)
    ends_s = end.time_us / 1e6
    return Divergence(base.run_id, fork.run_id, seq, parted_s, ends_s, end.words, end.question, left_out, why)


def _effects(measured: pa.Table, base: str, fork: str, group: Sequence[Divergence]) -> Effects:
    def of(side: str, runs: list[str]) -> pa.Table:
        is_its = pc.and_(pc.equal(measured.column("side"), side), pc.is_in(measured.column("run_id"), pa.array(runs)))
        return measured.filter(is_its)

    bases = of(base, [divergence.base for divergence in group])
    with beside(of(fork, [divergence.fork for divergence in group]), bases) as database:
        if len(group) > 1:
            rows = typed(database.rows(EFFECTS), Effect)
        else:
            ended = {} if group[0].ends_s is None else UNKNOWN
            rows = typed([{**row, **ended} for row in database.rows(VALUES)], Effect)
    return Effects(
        architecture=bases.column("architecture")[0].as_py(),
        configuration=bases.column("configuration")[0].as_py(),
        pairs=len(group),
        diverging=sum(divergence.parts_at is not None for divergence in group),
        refused=refused_in(divergence.refused for divergence in group),
        rows=rows,
    )


def commit_pairs(out: Path, pairs: Iterable[Pair]) -> Head:
    """Commit each base and its fork to a ledger, which is created if there is none; return its head.

    Runs that it already holds are skipped.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError, WriteFailed: See `Writer`.
    """
    with Writer(out, ORIGIN) as writer, without_collection():
        existing = {*writer.existing_runs().runs}

        def missing() -> Iterator[LedgerRun]:
            for record in (record for pair in pairs for record in pair.records):
                if record.run_id not in existing:
                    existing.add(record.run_id)
                    yield record

        for waiting in parts_of(missing(), lambda _: 1, BATCH_RUNS):
            writer.append(stage(out, waiting))
        return writer.head


def changes_of(asked: str | Sequence[str]) -> Changes:
    """Return the changes of these texts and files; `before` comes from each base instead. Raises: UsageError."""
    texts = [asked] if isinstance(asked, str) else asked
    if not isinstance(texts, Sequence) or not all(isinstance(text, str) for text in texts):
        raise UsageError(
            f"changes: found {asked!r:.80}, expected a text, or a list of texts; an empty one changes nothing"
        )
    parts = [read_changes(Path(text)) if text.endswith(".toml") else parsed([text]) for text in texts]
    replace = msgspec.structs.replace
    return tuple(replace(one, before=None) if hasattr(one, "before") else one for part in parts for one in part)


def answers_of(model: str | None) -> tuple[str, ...]:
    """Return the change by which this model (`model:7`) answers what the record of a live run does not.

    Raises:
        UsageError: `model` is not of that form.
    """
    if model is None:
        return ()
    if not model.startswith(MODEL) or not model.removeprefix(MODEL).isdecimal():
        raise UsageError(f"{option('answers', printable.value(model))}: expected {MODEL} and a seed, as {MODEL}7")
    return (f"answer * {model}",)


def runs_of(view: View, architectures: Sequence[str], kinds: Sequence[str] = ("simulated",)) -> list[str]:
    """Return the runs of these kinds and architectures (or all), without forks and runs that another continues.

    Raises:
        UsageError: There is none.
    """
    continued = {*earlier_runs(view).values()}
    starts = [
        (run, one) for run, one in starts_of(view) if one.kind in kinds and not one.changes and run not in continued
    ]
    starts = [(run, one) for run, one in starts if one.kind != "live" or one.source == SOURCE]
    names = {started.architecture or "" for _, started in starts}
    for name in architectures:
        if name not in names:
            hint = printable.did_you_mean(name, names) or ";"
            raise UsageError(
                f"{option('architecture', printable.value(name))}: there is no such run{hint} expected one of "
                f"{', '.join(sorted(names)) or 'none: it holds no simulated run'}"
            )
    chosen = [run for run, started in starts if not architectures or started.architecture in architectures]
    if not chosen:
        raise UsageError(f"{view.path}: found no {kinds[0]} run that is not a fork itself, expected some to fork from")
    return chosen


def fork_pairs(view: View, runs: Sequence[str], changes: Changes) -> Iterator[Pair]:
    """Yield these runs of a ledger, each with its fork. Raises: UsageError if one cannot be made again."""
    records = (record for part in _parts(view, runs) for record in records_of(view, part))
    return forks_of((base_of_record(record, view.head.root) for record in records), changes)


def _parts(view: View, runs: Sequence[str]) -> list[list[str]]:
    """Return these runs in the order in which they end on record, in the batches that are judged together."""
    sizes = dict.fromkeys(runs, 0)
    for extent in sorted(view.extents(), key=lambda extent: extent.end):
        if extent.run in sizes:
            rows = sizes.pop(extent.run)
            sizes[extent.run] = rows + 2 * extent.rows
    return list(parts_of(sizes, sizes.__getitem__, EVENTS_AT_ONCE))


def fork_of(view: View, record: LedgerRun, changes: Changes) -> Pair:
    """Return the run with its fork. Raises: UsageError if it cannot be made again, or the changes have no effect."""
    base = base_of_record(record, view.head.root)
    return Pair(base, rerun(base).fork_with_effect(changes))
