"""Replay: simulating a run again from its parameters must give exactly the recorded events.

- Parameters (seed, architecture, scenario, constants): taken from `RunStarted` as recorded. Constants other than this
  version's are a remark (`recipes.py`).
- Facts of the world (`events/world.py`) and their times: scheduled again (`world/schedule.py`) and compared, so that
  none is missing, added or changed.
- The founding of the fleet, with its capabilities and trust: repeated for the recorded fleet size, and compared.
- Every decision (what, by whom, when, caused by which event): made again by the handlers, and compared.
- Plans (`ExperimentPlanned`, which is no run): taken as recorded; the name of a plan is a digest of it.
- The durations of messages, approaches, attempts, answers and executions, and whether a degraded actuator holds: drawn
  again under the recorded seed.

So a simulated run has only one possible record, and only its first event is trusted, whose digest is in the run's name.
The schedule extends to its horizon and a run ends when nothing is left to happen, so the whole schedule is in the
record. The facts of the paper's workflows follow from their scenario, and are also scheduled again.

The first event of a fork records its changes to its base (`recipes.py`). Both the fork and the base are simulated
again, and the number of events that they share is compared with the first event.

A live run whose commands are on record (`CommandGiven`) is rebuilt from these alone; their times and contents are
trusted. Other live runs record nothing to rebuild them from, and are refused. Foreign runs record what other systems
decided, which our handlers cannot repeat: they are counted, and cast no doubt.

On request, a replay takes the facts and answers of the world from the record (`recorded.py`). It then checks every
decision, and that none is missing, in whatever world the run took place; it does not check that world against the seed.

The record also holds the length of an execution, as `ends_us`. It is drawn again all the same: taking it from the
record would mean trusting the decision that is being checked.
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
from .recipes import WorldConstantsUsed, constants_used, remarks_on
from .run_replay import Difference, ForeignDigest, error_text, replay_run


class ReplayReport(msgspec.Struct, frozen=True):
    """The result of `replay`.

    Units: `commits`, `runs` and `events` (of runs) count what was replayed exactly as recorded; `recordings` counts
    foreign runs, which are not replayed.

    `remarks` do not cast doubt on a run: they name constants that are not this version's, and digests of states that
    were stored in another shape.
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
        is_recorded: Take the facts and answers of the world from the record.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `open_ledger`, and where a segment is missing.
    """
    view = open_ledger(path)
    groups = view.groups()[:commits]
    files = [tuple(_within(path, view.segment(number)) for number in group) for group in groups]
    differences: list[Difference] = []
    worlds: list[WorldConstantsUsed] = []
    digests: list[ForeignDigest] = []
    whole = runs = events = recordings = 0
    continued = frozenset(earlier_runs(view).values())
    for done, result in enumerate(_replayed(str(path), files, max(1, workers), is_recorded, continued), start=1):
        differences += result.differences
        worlds += result.worlds
        digests += result.digests
        whole, runs, events = whole + result.ok, runs + result.runs, events + result.events
        recordings += result.recordings
        if progress is not None:
            progress(done, len(files))
    remarks = (*remarks_on(worlds), *_remarks_on_digests(digests))
    return ReplayReport(not differences, tuple(differences[:MAX_PROBLEMS]), whole, runs, events, remarks, recordings)


def _remarks_on_digests(digests: Sequence[ForeignDigest]) -> Iterator[str]:
    """Yield a remark on digests of states in another shape, if there are any."""
    unlike = [digest for digest in digests if not digest.is_same]
    if digests:
        first = (unlike or digests)[0]
        outcome = f"{len(unlike):,} not compared" if unlike else "the same here"
        yield (
            f"state at cuts: {counted(len(digests), 'digest')} of a state that was stored in another shape "
            f"({value(first.shape)}, here {value(state_shape())}): {outcome}, first of run {value(first.run)}, seq "
            f"{first.seq}; everything that it follows from was replayed"
        )


def _within(path: Path, file: Path) -> str:
    """Return the path of a file relative to the ledger if it lies within, else its path."""
    return str(file.relative_to(path) if file.is_relative_to(path) else file)


def _ledger_file(file: str) -> str:
    """Return the file of the ledger that holds the rows; rows of the journal are read from a file elsewhere."""
    return JOURNAL if Path(file).is_absolute() else file


def _replayed(
    path: str, files: list[tuple[str, ...]], workers: int, is_recorded: bool, continued: frozenset[str]
) -> Iterator[CommitReport]:
    """Yield the report of each group of segments, in order."""
    arguments = repeat(path), range(len(files)), files, repeat(is_recorded), repeat(continued)
    with pool_of(workers, len(files)) as pool:
        yield from (pool.map if pool else map)(replay_commit, *arguments)


@without_collection()  # a run creates no cycles
def replay_commit(
    path: str,
    number: int,
    files: tuple[str, ...],
    is_recorded: bool = False,
    continued: Collection[str] = (),
) -> CommitReport:
    """Return the report on the runs in these files of the ledger, which share runs; `number` is that of the group.

    Runs in `continued` are replayed with the runs that continue them. Other arguments as for `replay`.

    Never raises.
    """
    differences: list[Difference] = []
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
                differences.append(msgspec.structs.replace(difference, commit=number, segment=_ledger_file(files[0])))
    except Exception as error:  # a check that fails in an unforeseen way is still a finding
        differences.append(
            Difference(
                None, None, None, None, "runs that can be replayed", error_text(error), number, _ledger_file(files[0])
            )
        )
    return CommitReport(tuple(differences), constants_used(starts), runs, events, tuple(digests), recordings)


def _cut_within(record: LedgerRun, runs: int = 1) -> Difference | None:
    """Return the difference if the record of this many runs has more cuts than lie between them."""
    cuts = [seq for seq, event in enumerate(record.events) if isinstance(event, RunContinued)]
    if len(cuts) < runs or type(record.events[0]) in ALONE:
        return None
    return Difference(record.run_id, cuts[runs - 1], "type", None, "a cut at event 1 of a run alone", "another one")


def _replay_chain(view: View, run: str, digests: list[ForeignDigest]) -> tuple[Difference | None, int, int]:
    """Replay a run with all that it continues; return the difference, and the numbers of runs and events."""
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
    """Yield the runs in these files of the ledger, which no other file shares.

    Where runs were interleaved, a file has a run in pieces.
    """
    pieces: dict[str, list[LedgerRun]] = {}
    for file in files:
        for piece in decode(segment.read_table(path / file), is_whole=False):
            pieces.setdefault(piece.run_id, []).append(piece)
    for run in [*pieces]:
        yield joined(pieces.pop(run))  # frees its memory
