"""Try every single-bit flip and every length of every file of a ledger, and files in each other's place: `python -m
tests.ledger.damage_soak`.

Each damage is made alone. `verify` looks at the whole ledger, and must find it and name the file. Unchanged segments
are decoded only once. Prints counts by kind of file; exits with 1 if a damage is not found or not placed.
"""

import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.ledger.verify.notes import read_anchor
from fsar_ledger.ledger.verify.report import Asked
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.damage import SIGNER, cases, files_of, flips, is_placed, kind_of, write_ledger
from tests.ledger.forgery import examined_once

SIZES = (280, 20)
SWAPPED_SIZES = (130, 130, 20, 20)
CHUNK = 512
"""Bytes of a file that one task flips."""


class Task(NamedTuple):
    """A part of one file: each bit from byte `first` to before `last` is flipped, or the file is cut to each of these
    lengths."""

    name: str
    is_cut: bool
    first: int
    last: int


class Tally(NamedTuple):
    """How many damages were tried, found, and found in their place; and the first that was missed."""

    kind: str
    tried: int
    found: int
    placed: int
    missed: str = ""


def tasks(path: Path) -> Iterator[Task]:
    """Yield every flip and every length of every file, in parts."""
    for name in files_of(path):
        size = (path / name).stat().st_size
        for first in range(0, size, CHUNK):
            for is_cut in (False, True):
                yield Task(name, is_cut, first, min(size, first + CHUNK))


def try_all(place: tuple[str, str], part: Sequence[Task]) -> list[Tally]:
    """Do each task of this part, in a copy of the ledger."""
    folder, ledger = place
    with tempfile.TemporaryDirectory(dir=folder) as mine:
        path = Path(shutil.copytree(ledger, Path(mine) / "ledger"))
        with examined_once(path):
            return [_try(path, task) for task in part]


def _try(path: Path, task: Task) -> Tally:
    file = path / task.name
    good = file.read_bytes()
    kind = f"{kind_of(task.name)}: {'lengths' if task.is_cut else 'bits'}"
    tried = found = placed = 0
    missed = ""
    damaged = (
        (good[:length] for length in range(task.first, task.last))
        if task.is_cut
        else flips(good, task.first, task.last)
    )
    for data in damaged:
        file.write_bytes(data)
        report = verify(path)
        tried, found, placed = tried + 1, found + (not report.ok), placed + is_placed(report, {task.name})
        if placed < tried and not missed:
            missed = f"{task}, damage {tried - 1}: {report.problems[:3]}"
    file.write_bytes(good)
    return Tally(kind, tried, found, placed, missed)


def try_places(folder: Path) -> Iterator[Tally]:
    """Remove, replace, exchange, replay and add every file; drop every tail, with each later checkpoint as anchor."""
    path = folder / "swapped" / "ledger"
    write_ledger(path, SWAPPED_SIZES, folder / "snapshots")
    with examined_once(path):
        for case in list(cases(path)):
            case.do()
            report = verify(path)
            is_right = is_placed(report, case.places)
            yield Tally(
                "files removed, replaced, exchanged, replayed, added",
                1,
                not report.ok,
                is_right,
                "" if is_right else f"{case.name}: {report.problems[:3]}",
            )
            shutil.rmtree(folder / "swapped")
            shutil.copytree(folder / "snapshots" / str(len(SWAPPED_SIZES)), path)
    for kept in range(1, len(SWAPPED_SIZES)):
        for number in range(kept + 1, len(SWAPPED_SIZES) + 1):
            for is_quick in (False, True):
                anchor = read_anchor(folder / "snapshots" / str(number) / "checkpoint")
                report = verify(folder / "snapshots" / str(kept), asked=Asked(is_quick, SIGNER.verifier, anchor))
                is_right = not report.ok and "the newest were removed" in report.problems[0].expected
                yield Tally(
                    "tails dropped from all files, with an anchor",
                    1,
                    not report.ok,
                    is_right,
                    "" if is_right else f"{kept} of {number}: {report}",
                )


def main() -> int:
    """Try and count every damage; return 0 if each was found and placed."""
    began = time.monotonic()
    workers = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as place:
        folder = Path(place)
        write_ledger(folder / "ledger", SIZES)
        assert verify(folder / "ledger").ok
        every = list(tasks(folder / "ledger"))
        parts = [every[at::64] for at in range(64)]
        tallies = list(try_places(folder))
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for done, found in enumerate(pool.map(try_all, [(place, str(folder / "ledger"))] * len(parts), parts)):
                tallies += found
                if sys.stderr.isatty():
                    print(f"\r{done + 1} of {len(parts)} parts", end="", file=sys.stderr)
        assert verify(folder / "ledger").ok
    counts: dict[str, Counter[str]] = {}
    for tally in tallies:
        counts.setdefault(tally.kind, Counter()).update(tried=tally.tried, found=tally.found, placed=tally.placed)
    print(f"{'damage':52}{'tried':>9}{'found':>9}{'placed':>9}")
    for kind, count in sorted(counts.items()):
        print(f"{kind:52}{count['tried']:9,}{count['found']:9,}{count['placed']:9,}")
    missed = [tally.missed for tally in tallies if tally.missed]
    print("\n".join(missed[:10]))
    total = sum((count for count in counts.values()), Counter())
    print(
        f"{total['tried']:,} damages of a ledger of {sum(SIZES)} events, {total['found']:,} found, "
        f"{total['placed']:,} placed; {time.monotonic() - began:.0f} s"
    )
    return 0 if total["tried"] == total["found"] == total["placed"] > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
