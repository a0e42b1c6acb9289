"""Damage to a ledger, case by case, and what the damage to each byte of their files may pass for.

A crash may tear the end of the chain or of `journal.jsonl` (docs/ledger-format.md, section 7). So a damage there is
not found if the note in `checkpoint` does not go beyond what is whole before it. Then the ledger must be told as it was
before, to the root. Nor is another `release` found in the last record of the journal, of which nothing else tells it,
nor less room after the last frame of `sealing.jsonl`; then the ledger must be told as it is. Every other damage must be
found, with its place.
"""

import math
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate, combinations
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.rows.runs import piece as piece_of
from fsar_ledger.ledger.store import journal
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.journal import size_of
from fsar_ledger.ledger.store.paths import CHAIN, CHECKPOINT, INDEX, JOURNAL, MANIFEST, NODES, SEALING
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import segment_of
from fsar_ledger.ledger.store.snapshot import behind
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions, VerifyReport
from tests.ledger.agreement_chain import hand_over
from tests.ledger.samples import ORIGIN, made_up_run

SIGNER = Signer(ORIGIN, bytes(range(32)))


class Case(NamedTuple):
    """One damage: what to do to the ledger, and the files of which one must be named."""

    name: str
    do: Callable[[], object]
    places: frozenset[str]


def write_ledger(path: Path, sizes: Sequence[int], snapshots: Path | None = None) -> None:
    """Write a signed ledger with one run of this many events per commit; `snapshots/N` holds it after N commits."""
    for number, size in enumerate(sizes):
        with Writer(path, ORIGIN, SIGNER) as writer:
            writer.append(stage(path, [made_up_run(f"run-{number:04d}", size, seed=number)]))
        if snapshots is not None:
            shutil.copytree(path, snapshots / str(number + 1))


def files_of(path: Path) -> list[str]:
    """Return the names of all files of the ledger, within it."""
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def kind_of(name: str) -> str:
    """Return the kind of file that has this name."""
    return "segments" if name.startswith("segments/") else name


def flips(data: bytes, first: int = 0, last: int | None = None) -> Iterator[bytes]:
    """Yield the bytes with each bit flipped in turn, from byte `first` to before `last`."""
    flipped = bytearray(data)
    for at in range(first, len(data) if last is None else last):
        for bit in range(8):
            flipped[at] ^= 1 << bit
            yield bytes(flipped)
            flipped[at] ^= 1 << bit


def only_problem(path: Path, asked: VerifyOptions | None = None) -> Problem:
    """Return the single problem that `verify` reports."""
    (problem,) = verify(path, asked=asked).problems
    return problem


def is_placed(report: VerifyReport, places: Iterable[str]) -> bool:
    """Return whether the report names one of these files, with its commit if it belongs to one.

    For a document, it may also name the file that disagrees with it: nobody can know which of the two was altered.
    """
    return (
        not report.ok
        and report.root is None
        and any(_names(problem, place) for problem in report.problems for place in places)
    )


def _names(problem: Problem, place: str) -> bool:
    is_stray = any(problem.found == stray for stray in ("a stray file", "a file of no placement"))
    if place.startswith("segments/") and problem.commit is None and not is_stray:
        return False
    return problem.where == place or (place.endswith((".json", ".jsonl", "checkpoint")) and place in str(problem))


def alone(path: Path, name: str) -> Iterator[Case]:
    """Yield each damage to this file alone."""
    file, data, places = path / name, (path / name).read_bytes(), frozenset({name})

    def put_beside() -> None:
        aside = path.parent / "aside"
        aside.write_bytes(data)
        file.unlink()
        file.symlink_to(aside)

    def instead(make: Callable[[], object]) -> Callable[[], object]:
        def do() -> None:
            file.unlink()
            make()

        return do

    yield Case(f"{name} removed", file.unlink, places)
    yield Case(f"{name} emptied", lambda: file.write_bytes(b""), places)
    yield Case(f"{name} doubled", lambda: file.write_bytes(data + data), places)
    yield Case(f"{name} with one byte more", lambda: file.write_bytes(data + b"\0"), places)
    yield Case(f"{name} zeroed", lambda: file.write_bytes(bytes(len(data))), places)
    yield Case(f"{name} a link to itself elsewhere", put_beside, places)
    yield Case(f"{name} a folder", instead(file.mkdir), places)
    yield Case(f"{name} a pipe", instead(lambda: os.mkfifo(file)), places)


RUNS = [made_up_run(f"run-{number}", size, number) for number, size in enumerate((70, 12, 9, 6))]
ROOM = 64
"""Bytes by which the journal grows here, so that its room is soon damaged, too."""


def piece(number: int, first: int, end: int) -> LedgerRun:
    """Return these events of a run, which goes on unless they are its last."""
    return piece_of(RUNS[number], first, end)


def keep(path: Path, snapshots: Path | None) -> None:
    """Copy the ledger to `snapshots/N`, N being how many are there."""
    if snapshots is not None:
        snapshots.mkdir(exist_ok=True)
        shutil.copytree(path, snapshots / str(len(os.listdir(snapshots))))


def write_closed(path: Path, snapshots: Path | None = None) -> None:
    """Write a signed ledger: two segments, of which one was made of two others, and three commits in the journal; then
    close it. `snapshots/N` holds it after N + 1 sessions."""
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, [RUNS[0]]))
    keep(path, snapshots)
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.add([piece(1, 0, 4)])
    keep(path, snapshots)
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.compact()
    keep(path, snapshots)
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, [RUNS[2]]))
        writer.add([piece(1, 4, 5)])
        writer.add([piece(1, 5, 6), piece(3, 0, 2)])
        writer.add([piece(1, 6, 8)])
    keep(path, snapshots)


@contextmanager
def left_open(path: Path) -> Iterator[tuple[Writer, Path]]:
    """Yield a writer and its ledger, which becomes `path` as the writer leaves it open; its journal has room."""
    other = path.with_name(f"{path.name}-begun")
    with patch.object(journal, "ALLOTTED", ROOM), Writer(other, ORIGIN, SIGNER) as writer:
        yield writer, other
        shutil.copytree(other, path)


def write_open(path: Path) -> None:
    """Write a ledger that its writer left open: the checkpoint covers nothing of the journal, which has room."""
    with left_open(path) as (writer, other):
        writer.append(stage(other, [RUNS[2]]))
        for first in range(3):
            writer.add([piece(1, 2 * first, 2 * first + 2)])


def write_handed_over(path: Path) -> None:
    """Write a ledger that its writer left open after it had handed over its journal twice: of `sealing.jsonl`, the
    chain has the first commit and lacks the second."""
    with left_open(path) as (writer, _):
        writer.add([piece(1, 0, 2)])
        hand_over(writer)
        writer.add([piece(1, 2, 4)])
        writer.settle()
        writer.add([piece(1, 4, 6)])
        hand_over(writer)
        writer.add([piece(1, 6, 8)])


def write_cut_short(path: Path) -> None:
    """Write a ledger whose writer ended right after an append to the chain: nothing that follows from it is there."""
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, [RUNS[2]]))
        before = {name: (path / name).read_bytes() for name in (NODES, INDEX, CHECKPOINT) if (path / name).exists()}
        staged = stage(path, [RUNS[0]])
        there = set(files_of(path))
        writer.append(staged)
    [new] = [name for name in files_of(path) if name.startswith("segments/") and name not in there]
    (path / new).rename(path / "staging" / f"{staged.segment_sha256}.parquet")
    for name in (NODES, INDEX, CHECKPOINT):
        (path / name).write_bytes(before.get(name, b""))


LEDGERS = {
    "closed": write_closed,
    "left open": write_open,
    "handed over": write_handed_over,
    "cut short": write_cut_short,
}


class Whole(NamedTuple):
    """Where an append to the chain, or a frame of the journal, ends, and the size and root of the ledger then."""

    name: str
    end: int
    size: int
    root: str


class Allowance:
    """What of a ledger a crash may have torn, by the rule above."""

    def __init__(self, path: Path) -> None:
        view = open_ledger(path)
        assert isinstance(view, View)
        self._covered = view.commits[-behind(view) - 1].tree_size
        lines = (path / CHAIN).read_bytes()[: view.followed.last].split(b"\n")
        commits = sum(b'"kind":"commit"' in line for line in lines)
        own = view.journal.frames[view.journal.sealing :]
        sealing = list(accumulate(map(size_of, view.journal.frames[: view.journal.sealing]), initial=0))
        before, others = view.commits[commits - 1], view.commits[-len(own) - 1]
        self._has_journal = bool(view.journal.frames)
        self._wholes = [
            Whole(CHAIN, view.followed.last, before.tree_size, before.tree_root),
            Whole(JOURNAL, 0, others.tree_size, others.tree_root),
        ]
        end = 0
        for frame in own:
            end += size_of(frame)
            self._wholes.append(Whole(JOURNAL, end, frame.commit.tree_size, frame.commit.tree_root))
        self._wholes.append(Whole(SEALING, sealing[-1], view.head.size, view.head.root))
        self._last = {CHAIN: view.followed.last, JOURNAL: view.journal.last, SEALING: math.inf}  # only cut, not changed
        self._handed_over = sealing[:-1]  # where its frames begin
        # Of the chain, no placement with more behind it follows the one before the last.
        self._end = {
            CHAIN: (path / CHAIN).read_bytes().rfind(b"\n", 0, view.followed.last - 1),
            JOURNAL: view.journal.last,
        }
        self._release = range(0)
        if view.journal.frames:
            at = view.journal.last + view.journal.frames[-1].line.index(b'"release":"') + 11
            self._release = range(at, at + len(view.commits[-1].release))
        self._whole = view.head.root
        self._newest = segment_of(view.chain.placements[-1])

    def root(self, name: str, at: int, *, is_cut: bool) -> str | None:
        """Return the root of what remains if this file is cut or changed there; None if that must be found."""
        before = [one for one in self._wholes if one.name == name and one.end <= at]
        if not before or (name == CHAIN and self._has_journal) or not (is_cut or at >= self._last[name]):
            return None
        return before[-1].root if before[-1].size >= self._covered else None

    def is_release(self, report: VerifyReport, name: str, at: int) -> bool:
        """Return whether all but the release of the newest commit is told as it is."""
        return name == JOURNAL and at in self._release and report.root == self._whole

    def places(self, name: str, at: int, *, is_cut: bool) -> set[str]:
        """Return the files of which a finding may name one.

        Where the end is torn, the checkpoint shows it; and which of the last placement and its segment was altered,
        nobody knows. What `sealing.jsonl` lacks or tells otherwise at its end shows from the frame that follows.
        """
        if name == SEALING and (at in self._handed_over if is_cut else at >= self._handed_over[-1]):
            return {SEALING, JOURNAL}
        if name not in self._end or not (is_cut or at >= self._end[name]):
            return {name}
        return {name, CHECKPOINT} | ({self._newest} if name == CHAIN else set())


def look(path: Path, allowance: Allowance, name: str, at: int, *, is_cut: bool) -> str:
    """Verify a ledger that was damaged there, and return as `verdict`; with the key where nothing else is found."""
    report = verify(path)
    found = verdict(report, allowance, name, at, is_cut=is_cut)
    if found == "missed":  # nothing but the key vouches for the signature of the newest commit
        report = verify(path, asked=VerifyOptions(trusted=SIGNER.verifier))
        found = verdict(report, allowance, name, at, is_cut=is_cut)
    return found


def verdict(report: VerifyReport, allowance: Allowance, name: str, at: int, *, is_cut: bool) -> str:
    """Return `placed`, `found`, `left` (what a crash may leave, told as it is) or `missed`."""
    if report.ok:
        is_left = report.root == allowance.root(name, at, is_cut=is_cut) or allowance.is_release(report, name, at)
        return "left" if is_left else "missed"
    return "placed" if is_placed(report, allowance.places(name, at, is_cut=is_cut)) else "found"


def cases(path: Path) -> Iterator[Case]:
    """Yield each damage to whole files: any removed, emptied, extended or replaced, any two exchanged, and strays."""
    names = files_of(path)
    for name in names:
        for case in alone(path, name):
            if not (name in (CHAIN, JOURNAL) and "one byte more" in case.name):  # that is a torn end
                yield case._replace(places=_with_checkpoint(case.places))
    for one, other in combinations(names, 2):
        data = (path / one).read_bytes(), (path / other).read_bytes()
        for first, second in ((data[1], data[0]), (data[1], data[1]), (data[0], data[0])):

            def write(names: tuple[str, str] = (one, other), files: tuple[bytes, bytes] = (first, second)) -> None:
                for name, held in zip(names, files, strict=True):
                    (path / name).write_bytes(held)

            places = frozenset({one} if first != data[0] else set()) | frozenset({other} if second != data[1] else ())
            yield Case(f"{one} and {other} exchanged, or one twice", write, _with_checkpoint(places))
    segment = next(name for name in names if name.startswith("segments/"))
    strays = ("segments/x", "segments/000000000000-000000000001.parquet", "chain.jsonl~", "tile/0/000", "commits/0")
    for name in strays:
        place = name if name.startswith("segments") else name.partition("/")[0]
        yield Case(f"{name} is there", lambda name=name: _copy(path, segment, name), frozenset({place}))  # type: ignore[misc]
    for folder in ("segments", "staging"):
        yield Case(f"{folder} elsewhere", lambda folder=folder: _link(path, folder), frozenset({folder}))  # type: ignore[misc]
    yield Case("segments removed", lambda: shutil.rmtree(path / "segments"), frozenset({"segments"}))


def _with_checkpoint(places: frozenset[str]) -> frozenset[str]:
    return places | {CHECKPOINT} if places & {CHAIN, JOURNAL, MANIFEST} else places


def _copy(path: Path, source: str, name: str) -> None:
    (path / name).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path / source, path / name)


def _link(path: Path, folder: str) -> None:
    aside = path.parent / "aside"
    (path / folder).rename(aside)
    (path / folder).symlink_to(aside)
