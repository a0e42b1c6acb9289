"""Damage to a ledger, case by case: every bit, every length, and files in each other's place."""

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.store.append import stage
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import VERSION
from fsar_ledger.ledger.verify.report import Asked, VerifyReport
from fsar_ledger.ledger.verify.verify import verify
from fsar_ledger.ledger.writing import open_writer
from tests.ledger.samples import ORIGIN, made_up_run

SIGNER = Signer(ORIGIN, bytes(range(32)))


class Case(NamedTuple):
    """One damage: what to do to the ledger, and the files of which one must be named."""

    name: str
    do: Callable[[], object]
    places: frozenset[str]


def write_ledger(path: Path, sizes: Sequence[int], snapshots: Path | None = None, version: int = VERSION) -> None:
    """Write a signed ledger with one run of this many events per commit; `snapshots/N` holds it after N commits."""
    for number, size in enumerate(sizes):
        with open_writer(path, ORIGIN, SIGNER, version=version) as writer:
            writer.append(stage(path, [made_up_run(f"run-{number:04d}", size, seed=number)]))
        if snapshots is not None:
            shutil.copytree(path, snapshots / str(number + 1))


def files_of(path: Path) -> list[str]:
    """Return the names of all files of the ledger, within it."""
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def kind_of(name: str) -> str:
    """Return the kind of file that has this name."""
    folder, _, rest = name.partition("/")
    return {
        "commits": "records",
        "segments": "segments",
        "tile": "partial tiles" if ".p/" in rest else "full tiles",
    }.get(folder, name)


def flips(data: bytes, first: int = 0, last: int | None = None) -> Iterator[bytes]:
    """Yield the bytes with each bit flipped in turn, from byte `first` to before `last`."""
    flipped = bytearray(data)
    for at in range(first, len(data) if last is None else last):
        for bit in range(8):
            flipped[at] ^= 1 << bit
            yield bytes(flipped)
            flipped[at] ^= 1 << bit


def only_problem(path: Path, asked: Asked | None = None) -> Problem:
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
    is_stray = any(
        problem.found == stray for stray in ("a stray file", "a file of no commit", "a file of no placement")
    )
    if place.startswith(("commits/", "segments/")) and problem.commit is None and not is_stray:
        return False
    return problem.where == place or (place.endswith((".json", ".jsonl", "checkpoint")) and place in str(problem))


def cases(path: Path) -> Iterator[Case]:
    """Yield each damage to whole files: any removed, emptied, extended or replaced, and any two of a kind exchanged."""
    names = files_of(path)
    for name in names:
        yield from alone(path, name)
    for one, other in combinations(names, 2):
        if kind_of(one).rpartition(" ")[2] == kind_of(other).rpartition(" ")[2]:
            yield from _together(path, one, other)
    yield from _strays(path)


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

    is_last = name == max((other for other in files_of(path) if other.startswith("commits/")), default="")
    orphan = frozenset({name.replace("commits", "segments").replace("json", "parquet")}) if is_last else places
    yield Case(f"{name} removed", file.unlink, orphan)
    yield Case(f"{name} emptied", lambda: file.write_bytes(b""), places)
    yield Case(f"{name} doubled", lambda: file.write_bytes(data + data), places)
    yield Case(f"{name} with one byte more", lambda: file.write_bytes(data + b"\0"), places)
    yield Case(f"{name} zeroed", lambda: file.write_bytes(bytes(len(data))), places)
    yield Case(f"{name} a link to itself elsewhere", put_beside, places)
    yield Case(f"{name} a folder", instead(file.mkdir), places)
    yield Case(f"{name} a pipe", instead(lambda: os.mkfifo(file)), places)


def _together(path: Path, one: str, other: str) -> Iterator[Case]:
    first, second = path / one, path / other
    data = first.read_bytes(), second.read_bytes()
    places = frozenset({one, other})
    yield Case(
        f"{one} and {other} exchanged", lambda: (first.write_bytes(data[1]), second.write_bytes(data[0])), places
    )
    yield Case(f"{one} once more as {other}", lambda: second.write_bytes(data[0]), places)
    yield Case(f"{other} once more as {one}", lambda: first.write_bytes(data[1]), places)


def _strays(path: Path) -> Iterator[Case]:
    count = len(os.listdir(path / "commits"))
    last = f"{count - 1:012d}", f"{count:012d}"
    copies = [
        (f"commits/{last[0]}.json", f"commits/{last[1]}.json"),
        (f"segments/{last[0]}.parquet", f"segments/{last[1]}.parquet"),
    ]
    copies += [
        ("tile/0/000", name)
        for name in (
            "tile/0/001",
            "tile/0/x001/000",
            "tile/1/000",
            "tile/2/000",
            "tile/x",
            "tile/0/000.p/255",
            "tile/0/001.p/x",
        )
    ]
    copies += [
        ("checkpoint", "checkpoint.old"),
        ("ledger.json", "ledger.json~"),
        ("checkpoint", "tile/checkpoint"),
        ("checkpoint", "segments/checkpoint"),
    ]

    def copy(source: str, name: str) -> None:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path / source, path / name)

    for source, name in copies:
        yield Case(
            f"{source} once more as {name}",
            lambda source=source, name=name: copy(source, name),  # type: ignore[misc]
            frozenset({name}),
        )
    for folder in ("commits", "segments", "tile", "tile/0", "tile/0/001.p"):
        yield Case(
            f"{folder} a link to itself elsewhere",
            lambda folder=folder: _put_aside(path, folder),  # type: ignore[misc]
            frozenset({folder}),
        )
    for folder in ("commits", "segments"):
        yield Case(f"{folder} removed", lambda folder=folder: shutil.rmtree(path / folder), frozenset({folder}))  # type: ignore[misc]


def _put_aside(path: Path, folder: str) -> None:
    aside = path.parent / "aside"
    (path / folder).rename(aside)
    (path / folder).symlink_to(aside)
