"""Try every single-bit flip and every length of every file of a ledger, and files in each other's place: `python -m
tests.ledger.damage_soak [STEP]`.

Each damage is made alone. `verify` looks at the whole ledger, and must find it and name the file. One ledger was
closed, one left open, one left open with a journal that was handed over, and one cut short within an append: in all but
the first, a damage may pass for one that a crash leaves, by the rule in `damage`. With a STEP, only
every so many bytes of segments are tried. Unchanged segments are decoded only once. Prints counts by kind of file;
exits with 1 if a damage is not found or not placed.
"""

import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions, read_anchor
from tests.ledger.damage import (
    LEDGERS,
    SIGNER,
    Allowance,
    Case,
    cases,
    files_of,
    flips,
    is_placed,
    kind_of,
    look,
    write_closed,
)
from tests.ledger.once import decoded_once

CHUNK = 512
"""Bytes of a file that one task flips."""


class Task(NamedTuple):
    """A part of one file: each bit of each of these bytes is flipped, or the file is cut to each of these lengths."""

    name: str
    is_cut: bool
    at: range


class Tally(NamedTuple):
    """How many damages were tried, found, found in their place, and left as a crash may; and the first that was
    missed."""

    kind: str
    tried: int
    found: int
    placed: int
    left: int = 0
    missed: str = ""


def tasks(path: Path, step: int = 1) -> Iterator[Task]:
    """Yield every flip and every length of every file, in parts."""
    for name in files_of(path):
        size = (path / name).stat().st_size
        step_here = step if name.endswith(".parquet") else 1
        for first in range(0, size, CHUNK):
            for is_cut in (False, True):
                yield Task(name, is_cut, range(first, min(size, first + CHUNK), step_here))


def try_all(place: tuple[str, str], part: Sequence[Task]) -> list[Tally]:
    """Do each task of this part, in a copy of the ledger."""
    folder, ledger = place
    with tempfile.TemporaryDirectory(dir=folder) as mine:
        path = Path(shutil.copytree(ledger, Path(mine) / "ledger"))
        with decoded_once():
            allowance = Allowance(path)
            return [_try(path, task, Path(ledger).name, allowance) for task in part]


def _try(path: Path, task: Task, label: str, allowance: Allowance) -> Tally:
    file = path / task.name
    good = file.read_bytes()
    counts = Counter[str]()
    missed = ""
    for at in task.at:
        for data in [good[:at]] if task.is_cut else flips(good, at, at + 1):
            file.write_bytes(data)
            found = look(path, allowance, task.name, at, is_cut=task.is_cut)
            counts[found] += 1
            if found in ("missed", "found") and not missed:
                missed = f"{task}, byte {at}: {verify(path).problems[:3]}"
    file.write_bytes(good)
    kind = f"{label}: {kind_of(task.name)}: {'lengths' if task.is_cut else 'bits'}"
    return Tally(kind, counts.total(), counts["found"] + counts["placed"], counts["placed"], counts["left"], missed)


def _tried(kind: str, case: Case, path: Path, asked: VerifyOptions | None = None, expected: str = "") -> Tally:
    """Make this damage to whole files, and return whether it is found in its place."""
    case.do()
    report = verify(path, asked=asked)
    is_right = is_placed(report, case.places) and expected in report.problems[0].expected
    return Tally(kind, 1, not report.ok, is_right, 0, "" if is_right else f"{case.name}: {report.problems[:3]}")


def try_places(folder: Path) -> Iterator[Tally]:
    """Remove, replace, exchange, replay and add every file; drop every tail, with each later checkpoint as anchor."""
    path = folder / "swapped" / "ledger"
    write_closed(path, folder / "snapshots")
    with decoded_once():
        yield from _places(folder, path, range(len(os.listdir(folder / "snapshots"))))


def _places(folder: Path, path: Path, snapshots: Sequence[int]) -> Iterator[Tally]:
    for case in list(cases(path)):
        yield _tried("files removed, replaced, exchanged, replayed, added", case, path)
        shutil.rmtree(folder / "swapped")
        shutil.copytree(folder / "snapshots" / str(snapshots[-1]), path)
    for kept, number in combinations(snapshots, 2):
        anchor = read_anchor(folder / "snapshots" / str(number) / "checkpoint")
        ledger = folder / "snapshots" / str(kept)
        if anchor.note is None or anchor.note.checkpoint.size == open_ledger(ledger).head.size:
            continue  # nothing was added in between: segments were compacted
        for is_quick in (False, True):
            asked = VerifyOptions(is_quick, SIGNER.verifier, anchor)
            case = Case(f"{kept} of {number}", lambda: None, frozenset({anchor.file}))
            yield _tried("tails dropped from all files, with an anchor", case, ledger, asked, "the newest were removed")


def tallies_of(folder: Path, step: int) -> Iterator[Tally]:
    """Try every damage."""
    yield from try_places(folder)
    for name, write in LEDGERS.items():
        path = folder / "whole" / name
        path.parent.mkdir(exist_ok=True)
        write(path)
        assert verify(path).ok
        every = list(tasks(path, step))
        parts = [every[at::64] for at in range(64)]
        with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn")) as pool:
            for done, found in enumerate(pool.map(try_all, [(str(folder), str(path))] * len(parts), parts)):
                yield from found
                if sys.stderr.isatty():
                    print(f"\r{done + 1} of {len(parts)} parts", end="", file=sys.stderr)
        assert verify(path).ok


def main(arguments: list[str]) -> int:
    """Try and count every damage; return 0 if each was found and placed."""
    step = int(arguments[0]) if arguments else 1
    began = time.monotonic()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as place:
        tallies = list(tallies_of(Path(place), step))
    counts: dict[str, Counter[str]] = {}
    for tally in tallies:
        counts.setdefault(tally.kind, Counter()).update(
            tried=tally.tried, found=tally.found, placed=tally.placed, left=tally.left
        )
    print(f"{'damage':58}{'tried':>9}{'found':>9}{'placed':>9}{'left':>9}")
    for kind, count in sorted(counts.items()):
        print(f"{kind:58}{count['tried']:9,}{count['found']:9,}{count['placed']:9,}{count['left']:9,}")
    print("\n".join([tally.missed for tally in tallies if tally.missed][:10]))
    total = sum((count for count in counts.values()), Counter())
    print(
        f"{total['tried']:,} damages, {total['found']:,} found, {total['placed']:,} placed, {total['left']:,} left as "
        f"a crash leaves them; {time.monotonic() - began:.0f} s",
        flush=True,
    )
    return 0 if total["tried"] - total["left"] == total["found"] == total["placed"] > 0 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
