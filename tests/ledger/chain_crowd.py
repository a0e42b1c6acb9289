"""As `crowd`, of a ledger of format 2: writers that append, journal, seal and compact, and readers beside them."""

import select
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import msgspec

from fsar_ledger.errors import FsarLedgerError, NotALedger
from fsar_ledger.ledger.chain.append import ChainWriter
from fsar_ledger.ledger.chain.read import ChainView
from fsar_ledger.ledger.chain.record import Commit
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import stage
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.crowd import NAMES
from tests.ledger.samples import ORIGIN, made_up_run

CUTS = (0, 5, 8, 12)
"""Each run of a writer is committed in three parts, which end here."""


@cache
def part(name: str, number: int) -> LedgerRun:
    """Return what this writer commits in this step: a part of one of its runs, after the one before."""
    run, at = divmod(number, len(CUTS) - 1)
    whole = made_up_run(f"{name}-{run:04d}", CUTS[-1], seed=NAMES.index(name) * 1000 + run)
    first, end = CUTS[at : at + 2]
    return LedgerRun(
        whole.run_id,
        whole.times_us[first:end],
        whole.caused_by[first:end],
        whole.events[first:end],
        first,
        end < CUTS[-1],
    )


@cache
def rows_of(name: str, number: int) -> Sequence[bytes]:
    """Return the canonical bytes of this part."""
    return encode_lines([part(name, number)])


def write(path: Path, name: str, steps: int, say: Callable[[str, object], None]) -> None:
    """Take all steps of this writer; each is acknowledged at once. Every fifth goes into a segment of its own, and now
    and then the journal is sealed, or the segments are compacted."""
    with ChainWriter(path, ORIGIN) as writer:
        done = own_steps(open_for_answers(path), name)
        say("acknowledged", done)
        for number in range(done, steps):
            kind = NAMES.index(name) + number
            if kind % 5:
                writer.add([part(name, number)])
            else:
                writer.append(stage(path, [part(name, number)]))
            say("acknowledged", number + 1)
            if kind % 7 == 3:
                writer.seal()
            elif kind % 7 == 6:
                writer.compact()


def steps_in(view: ChainView, commits: Sequence[Commit]) -> list[tuple[str, Sequence[bytes]]]:
    """Return the writer of each of these commits, and its rows."""
    found: list[tuple[str, Sequence[bytes]]] = []
    for commit in commits:
        rows = view.rows(commit.tree_size - commit.rows, commit.tree_size)
        run = msgspec.json.decode(rows[0], type=dict[str, object])["run_id"]
        found.append((str(run).partition("-")[0], rows))
    return found


def own_steps(view: object, name: str) -> int:
    """Return how many steps of this writer the ledger holds."""
    assert isinstance(view, ChainView)
    return sum(writer == name for writer, _ in steps_in(view, view.commits))


def watch(path: Path, stop: int, say: Callable[[str, object], None]) -> None:
    """Check that every head is a whole commit and contains the one before, and that all its rows can be read."""
    before: ChainView | None = None
    while True:
        is_last = bool(select.select([stop], [], [], 0)[0])
        try:
            view = open_for_answers(path)
        except NotALedger:
            if before is not None:
                raise
        else:
            assert isinstance(view, ChainView)
            if before is not None and view.commits[: before.head.commits] != before.commits:
                say("wrong", f"a reader of {view.head.commits} commits no longer saw those that it had seen")
            if before is None or view.head != before.head:
                say("head", view.head.commits)
                for complaint in judge(path, {}):
                    say("wrong", f"while others append: {complaint}")
            before = view
        if is_last:
            return


def judge(path: Path, acknowledged: Mapping[str, int]) -> list[str]:
    """Return what is wrong with the ledger that these writers shared: nothing if every acknowledged step is there once,
    whole and in its writer's order, however its events are read."""
    if not (path / MANIFEST).exists():
        return ["lost: the ledger is gone"] if any(acknowledged.values()) else []
    complaints = []
    found = Counter[str]()
    try:
        view = open_for_answers(path)
        assert isinstance(view, ChainView)
        for number, (name, rows) in enumerate(steps_in(view, view.commits)):
            if rows != rows_of(name, found[name]):
                complaints.append(f"torn: commit {number} does not hold step {found[name]} of {name}")
            found[name] += 1
        runs = {run.run_id: len(run.events) for run in view.runs()}
        expected = Counter(part(name, step).run_id for name in found for step in range(found[name]))
        if sum(runs.values()) != view.head.size or runs.keys() != expected.keys():
            complaints.append(f"torn: runs {runs} are read")
        if sorted(view.run_names.runs) != sorted(runs):
            complaints.append(f"torn: the index names the runs {view.run_names.runs}")
        report = verify(path)
    except FsarLedgerError as error:
        return [f"torn: a reader is told {error}"]
    complaints += [
        f"lost: {found[name]} of {count} acknowledged steps of {name} are there"
        for name, count in acknowledged.items()
        if found[name] < count
    ]
    if not report.ok:
        complaints.append(f"torn: verify found {'; '.join(map(str, report.problems))}")
    return complaints
