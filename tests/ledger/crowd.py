"""Several writers of one ledger that append, journal, seal and compact, and readers beside them: what each does, and
what must hold for the ledger at the end."""

import os
import random
import select
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.base.errors import FsarLedgerError, NotALedger, WriteFailed
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Commit
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.faults import SYNCS, WRITES, Fault, FaultyOs, in_place_of_os
from tests.ledger.samples import ORIGIN, made_up_run

NAMES = ("anna", "bela", "carl", "dora", "emil", "fred", "gina", "hugo")
CUTS = (0, 5, 8, 12)
"""Each run of a writer is committed in three parts, which end here."""


@cache
def part(name: str, number: int) -> LedgerRun:
    """Return what this writer commits in this step: a part of one of its runs, after the one before."""
    run, at = divmod(number, len(CUTS) - 1)
    whole = made_up_run(f"{name}-{run:04d}", CUTS[-1], seed=NAMES.index(name) * 1000 + run)
    first, end = CUTS[at : at + 2]
    return piece(whole, first, end)


@cache
def rows_of(name: str, number: int) -> Sequence[bytes]:
    """Return the canonical bytes of this part."""
    return encode_lines([part(name, number)])


def write(path: Path, name: str, steps: int, say: Callable[[str, object], None]) -> None:
    """Take all steps of this writer; each is acknowledged at once. Every fifth goes into a segment of its own, and now
    and then the journal is sealed, or the segments are compacted."""
    with Writer(path, ORIGIN) as writer:
        done = own_steps(open_for_answers(path), name)
        say("acknowledged", done)
        for number in range(done, steps):
            kind = NAMES.index(name) + number
            if kind % 5:
                writer.add([part(name, number)])
            else:
                writer.append(stage(path, [part(name, number)]))
            acknowledge(path, name, number + 1)
            say("acknowledged", number + 1)
            if kind % 7 == 3:
                writer.seal()
            elif kind % 7 == 6:
                writer.compact()


class RefusingOs(FaultyOs):
    """A disk that refuses writes and syncs alone, and counts nothing else."""

    def _call(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        if name in (*WRITES, *SYNCS) or self._is_dead:
            return super()._call(name, arguments, options)
        return self._do(name, arguments, options)


def write_refused(refusals: int, path: Path, name: str, steps: int, say: Callable[[str, object], None]) -> None:
    """As `write`, on a disk that refuses something so many times, soon after the writer has begun; then it begins
    again."""
    draw = random.Random(f"{path.name} {name} {steps}")
    elsewhere = path.with_name(name)  # what a power failure would leave is not asked
    elsewhere.mkdir(exist_ok=True)
    for _ in range(refusals):
        kind = draw.choice(("no-space", "io-error", "disk-full", "short-write-no-space"))
        try:
            with in_place_of_os(RefusingOs(elsewhere, Fault(draw.randrange(2, 60), kind))):
                write(path, name, steps, say)
        except WriteFailed:
            say("refused", 1)
    write(path, name, steps, say)


def acknowledged_in(path: Path) -> dict[str, int]:
    """Return how many steps of each writer were acknowledged by now, as `acknowledge` noted."""
    try:
        data = path.with_suffix(".acknowledged").read_bytes()
    except FileNotFoundError:
        return {}
    return {name: int.from_bytes(data[8 * at : 8 * at + 8], "big") for at, name in enumerate(NAMES)}


def acknowledge(path: Path, name: str, steps: int) -> None:
    """Note for readers that so many steps of this writer were acknowledged."""
    handle = os.open(path.with_suffix(".acknowledged"), os.O_WRONLY | os.O_CREAT, 0o666)
    os.pwrite(handle, steps.to_bytes(8, "big"), 8 * NAMES.index(name))
    os.close(handle)


def steps_in(view: View, commits: Sequence[Commit]) -> list[tuple[str, Sequence[bytes]]]:
    """Return the writer of each of these commits, and its rows."""
    found: list[tuple[str, Sequence[bytes]]] = []
    for commit in commits:
        rows = view.rows(commit.tree_size - commit.rows, commit.tree_size)
        run = msgspec.json.decode(rows[0], type=dict[str, object])["run_id"]
        found.append((str(run).partition("-")[0], rows))
    return found


def own_steps(view: object, name: str) -> int:
    """Return how many steps of this writer the ledger holds."""
    assert isinstance(view, View)
    return sum(writer == name for writer, _ in steps_in(view, view.commits))


def watch(path: Path, stop: int, say: Callable[[str, object], None]) -> None:
    """Check that every head is a whole commit and contains the one before and all that was acknowledged by then, each
    once; now and then, that all its rows can be read and verified."""
    before: View | None = None
    found = Counter[str]()
    heads = 0
    while True:
        is_last = bool(select.select([stop], [], [], 0)[0])
        try:
            known = acknowledged_in(path)
            view = open_for_answers(path)
        except NotALedger:
            if before is not None:
                raise
        else:
            assert isinstance(view, View)
            count = len(before.commits) if before is not None else 0
            if before is not None and view.commits[:count] != [*before.commits]:
                say("wrong", f"a reader of {view.head.commits} commits no longer saw those that it had seen")
            for name, rows in steps_in(view, view.commits[count:]):
                if rows != rows_of(name, found[name]):
                    say("wrong", f"a reader saw other rows than step {found[name]} of {name}")
                found[name] += 1
            if missed := [name for name, steps in known.items() if found[name] < steps]:
                say("wrong", f"a reader saw {found[missed[0]]} of {known[missed[0]]} acknowledged steps of {missed[0]}")
            if before is None or view.head != before.head:
                heads += 1
                say("head", view.head.commits)
                say("seen", f"{view.head.size} {view.head.root}")
            if is_last or heads % 25 == 1:
                heads += 1
                for complaint in judge(path, known):
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
        assert isinstance(view, View)
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
