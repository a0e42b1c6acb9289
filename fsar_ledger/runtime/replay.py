"""Replay: the world and the handlers must make a run again from its parameters, exactly as recorded, event by event.

- What was simulated (seed, architecture, scenario, constants): taken from `RunStarted` as recorded. Constants other
  than this version's are a remark (`recipes.py`).
- What the world did by itself (`events/world.py`), and when: made again (`world/schedule.py`) and compared, so that
  nothing is left out, added or changed.
- Who founds the fleet, with which capabilities and trust: made again for the recorded fleet size, and compared.
- Every decision (what, by whom, when, caused by which event): made again by the handlers, and compared.
- What was planned (`ExperimentPlanned`, which is no run): taken as recorded; its name is a digest of it.
- How long messages, ways, attempts, answers and executions take, and whether a degraded actuator holds: drawn again
  under the recorded seed.

So a simulated run has only one possible record, and nothing in it is taken on trust but its first event, whose digest
is in the run's name. The schedule is made to its horizon and a run ends when nothing is left to happen, so the whole
schedule is in the record. The facts of the paper's workflows follow from their scenario, and are also made again.

The first event of a fork says what is otherwise than in its base (`recipes.py`). The fork is made again with that, the
base without, and how far the one repeats the other is compared with what the first event says.

A live run whose commands are on record (`CommandGiven`) is made again from these alone; when they came and what they
say is taken on trust. Other live runs declare nothing from which they could be made: they are refused. Foreign runs are
recordings of what others decided, which no handler of ours could make: they are counted, and no doubt.

A replay can also be asked to take what the world did and answered from the record (`recorded.py`). It checks every
decision, and that none is missing, whatever world the run was in; that this world was the one of the seed, it does not.

The record also holds the length of an execution, as `ends_us`. It is drawn again all the same: taking it from the
record would be to believe the decision in question.
"""

from collections.abc import Collection, Iterator, Sequence
from itertools import repeat
from pathlib import Path

import msgspec

from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.printable import counted, value
from fsar_ledger.base.progress import Progress
from fsar_ledger.base.workers import pool_of
from fsar_ledger.events import ALONE
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.codec import LedgerRun, decode
from fsar_ledger.ledger.rows.runs import joined
from fsar_ledger.ledger.store.locations import chain_of, continued_by, earlier_runs, places_of, record_of
from fsar_ledger.ledger.store.paths import JOURNAL
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS

from .live import state_shape
from .recipes import (
    WorldConstantsUsed,
    constants_used,
    remarks_on,
)
from .run_replay import Difference, ForeignDigest, error_text, replay_run


class ReplayReport(msgspec.Struct, frozen=True):
    """The result of `replay`.

    Units: `commits`, `runs` and `events` (of runs) count what replay made exactly as recorded; `recordings` the foreign
    runs, which it does not make.

    `remarks` do not cast doubt on a run: they name constants that are not this version's, and digests of a state in a
    shape that is not.
    """

    ok: bool
    differences: tuple[Difference, ...] = ()
    commits: int = 0
    runs: int = 0
    events: int = 0
    remarks: tuple[str, ...] = ()
    recordings: int = 0


class CommitReport(msgspec.Struct, frozen=True):
    """The result of `replay_commit`: as `ReplayReport`, for one commit.

    `worlds` and `digests` are those of the runs that replayed as recorded.
    """

    differences: tuple[Difference, ...]
    worlds: tuple[WorldConstantsUsed, ...]
    runs: int
    events: int
    digests: tuple[ForeignDigest, ...] = ()
    recordings: int = 0

    @property
    def ok(self) -> bool:
        """Return whether nothing differs."""
        return not self.differences


NOT_REPLAYED = ReplayReport(False)
"""The report on a ledger that does not verify: its rows may not be what was recorded."""


def replay(
    path: Path,
    workers: int = 1,
    progress: Progress | None = None,
    commits: int | None = None,
    is_recorded: bool = False,
) -> ReplayReport:
    """Replay every run, and report the first difference of each run that differs or could not be checked.

    Args:
        path: The directory of the ledger, which is assumed to verify.
        workers: Number of processes; the report does not depend on it.
        progress: Called with (segments done, segments in all).
        commits: How many of the first commits to replay; None is all.
        is_recorded: Take what the world did and answered from the record.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `open_ledger`, and where a segment is missing.
    """
    view = open_ledger(path)
    groups = view.groups()[:commits]
    files = [tuple(_within(path, view.segment(number)) for number in group) for group in groups]
    found: list[Difference] = []
    worlds: list[WorldConstantsUsed] = []
    digests: list[ForeignDigest] = []
    whole = runs = events = recordings = 0
    continued = frozenset(earlier_runs(view).values())
    for done, result in enumerate(_replayed(str(path), files, max(1, workers), is_recorded, continued), start=1):
        found += result.differences
        worlds += result.worlds
        digests += result.digests
        whole, runs, events = whole + result.ok, runs + result.runs, events + result.events
        recordings += result.recordings
        if progress is not None:
            progress(done, len(files))
    remarks = (*remarks_on(worlds), *_remarks_on_digests(digests))
    return ReplayReport(not found, tuple(found[:MAX_PROBLEMS]), whole, runs, events, remarks, recordings)


def _remarks_on_digests(found: Sequence[ForeignDigest]) -> Iterator[str]:
    """Yield what is to be said of the digests of a state in another shape, if there are any."""
    unlike = [one for one in found if not one.is_same]
    if found:
        first = (unlike or found)[0]
        told = f"{len(unlike):,} not compared" if unlike else "the same here"
        yield (
            f"state at cuts: {counted(len(found), 'digest')} of a state that was kept in another shape "
            f"({value(first.shape)}, here {value(state_shape())}): {told}, first of run {value(first.run)}, seq "
            f"{first.seq}; all from which it follows was made again"
        )


def _within(path: Path, file: Path) -> str:
    """Return the name of a file within the ledger; of one outside, its path."""
    return str(file.relative_to(path) if file.is_relative_to(path) else file)


def _place(file: str) -> str:
    """Name where rows are in the ledger: those of the journal were put into a file elsewhere to be read."""
    return JOURNAL if Path(file).is_absolute() else file


def _replayed(
    path: str, files: list[tuple[str, ...]], workers: int, is_recorded: bool, continued: frozenset[str]
) -> Iterator[CommitReport]:
    """Yield the report of each group of segments, in order."""
    asked = repeat(path), range(len(files)), files, repeat(is_recorded), repeat(continued)
    with pool_of(workers, len(files)) as pool:
        yield from (pool.map if pool else map)(replay_commit, *asked)


@without_collection()  # a run makes no cyclic garbage
def replay_commit(
    path: str,
    number: int,
    files: tuple[str, ...],
    is_recorded: bool = False,
    continued: Collection[str] = (),
) -> CommitReport:
    """Return the report on the runs of one commit, in these files of the ledger; other arguments as of `replay`.

    Files are those that share runs, and `number` counts such groups. Runs of `continued` are left to those that
    continue them.

    Never raises.
    """
    found: list[Difference] = []
    starts: list[RunStarted] = []
    digests: list[ForeignDigest] = []
    runs = events = recordings = 0
    try:
        for record in _runs_in(Path(path), files):
            if record.run_id in continued:
                continue
            if isinstance(started := record.events[0], RunStarted) and started.kind == "foreign":
                recordings += 1
                continue
            if continued_by(record) is None:
                difference, parts, size = replay_run(record, is_recorded) or _cut_within(record), 1, len(record.events)
            else:
                difference, parts, size = _replay_chain(open_ledger(Path(path)), record.run_id, digests)
            if difference is None and type(record.events[0]) in ALONE:
                continue
            if difference is None:
                runs, events = runs + parts, events + size
                starts += [started] if isinstance(started, RunStarted) else []
            else:
                found.append(msgspec.structs.replace(difference, commit=number, segment=_place(files[0])))
    except Exception as error:  # a check that fails in an unforeseen way is still a finding
        found.append(
            Difference(None, None, None, None, "runs that can be replayed", error_text(error), number, _place(files[0]))
        )
    return CommitReport(tuple(found), constants_used(starts), runs, events, tuple(digests), recordings)


def _cut_within(record: LedgerRun, runs: int = 1) -> Difference | None:
    """Return the difference if the record of so many runs has more cuts than are between them."""
    cuts = [seq for seq, event in enumerate(record.events) if isinstance(event, RunContinued)]
    if len(cuts) < runs or type(record.events[0]) in ALONE:
        return None
    return Difference(record.run_id, cuts[runs - 1], "type", None, "a cut at event 1 of a run alone", "another one")


def _replay_chain(view: View, run: str, digests: list[ForeignDigest]) -> tuple[Difference | None, int, int]:
    """Replay a run from the beginning of those that it continues; return how many they are, and their events, too."""
    record, sizes = record_of(view, run), {commit.tree_root: commit.tree_size for commit in view.commits}
    cuts = [(seq, event) for seq, event in enumerate(record.events) if isinstance(event, RunContinued)]
    runs = chain_of(view, run)
    difference = replay_run(record, digests=digests) or _cut_within(record, len(runs))
    places = places_of(view, runs)
    for before, later, (seq, cut) in zip(runs, runs[1:], cuts, strict=False):
        size = sizes.get(cut.continues_root, -1)
        if difference is None and not places[before].last < size <= places[later].first:
            expected = f"the root of the ledger when run {value(before)} had ended, before run {value(later)}"
            difference = Difference(run, seq, "continues_root", None, expected, repr(cut.continues_root))
    return difference, len(cuts) + 1, len(record.events) + len(cuts)


def _runs_in(path: Path, files: tuple[str, ...]) -> Iterator[LedgerRun]:
    """Yield the runs in these files of the ledger, which share them with no others.

    Where runs took turns, one file has a run in pieces.
    """
    pieces: dict[str, list[LedgerRun]] = {}
    for file in files:
        for piece in decode(segment.read_table(path / file), is_whole=False):
            pieces.setdefault(piece.run_id, []).append(piece)
    for run in [*pieces]:
        yield joined(pieces.pop(run))  # no longer held then
