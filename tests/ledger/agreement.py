"""Judge good and damaged ledgers by the hundred with `verify` and the independent verifier, and compare them."""

import importlib
import json
import random
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa

from fsar_ledger.errors import NotALedger
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.log.hashing import leaves_of
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note, Signer, VerifierKey, checkpoint_of
from fsar_ledger.ledger.log.tiles import WIDTH, Edge, Tile
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import SCHEMA, Field
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import commit_path, segment_path
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import CommitRecord, sha256_hex
from fsar_ledger.ledger.verify.notes import read_anchor
from fsar_ledger.ledger.verify.report import Asked
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.hostile import stage_anything
from tests.ledger.samples import IN_RUNS, ORIGIN, made_up_run

ROOT = Path(__file__).resolve().parents[2]
KEY, STRANGER = Signer(ORIGIN, b"\1" * 32), Signer(ORIGIN, b"\2" * 32)
VERSION = pa.__version__.encode()
OTHER_VERSION = b"9" * len(VERSION)
ODD = [
    "",
    "A",
    '"',
    "\\",
    "/",
    "\n",
    "\x00",
    "\x1f",
    "\x7f",
    "\u0085",
    "é",
    "e\u0301",
    "\u2028",
    "\ufeff",
    "\uffff",
    "\U0001f916",
    "\U0010ffff",
    "0",
    " ",
]


@cache
def independent(module: str = "independent_verifier") -> Any:
    """Load the independent verifier from its file, as a module outside any package."""
    sys.path.insert(0, str(ROOT / "tests"))
    try:
        return importlib.import_module(module)
    finally:
        sys.path.pop(0)


@cache
def event_types() -> Any:
    return json.loads((ROOT / "docs" / "event-types.json").read_text("utf-8"))


# --- ledgers to begin with ---


def odd_run(run_id: str, size: int, draw: random.Random) -> LedgerRun:
    """Return a run of events of any type, with strings, integers and times that are hard to write."""

    def text() -> str:
        return "".join(draw.choice(ODD) for _ in range(draw.randrange(4)))

    def value(field: Field) -> object:
        if field.name == "observes":
            return CONCERNS
        if field.is_nullable and draw.random() < 0.3:
            return None
        if field.values is not None:
            return draw.choice(sorted(field.values))
        kinds: dict[str, Callable[[], object]] = {
            "integer": lambda: draw.choice([0, -1, 1 - 2**53, 2**53 - 1, draw.randrange(10**9)]),
            "boolean": lambda: draw.random() < 0.5,
            "strings": lambda: tuple(text() for _ in range(draw.randrange(3))),
            "string": text,
        }
        return kinds[field.kind]()

    layouts = [draw.choice(list(IN_RUNS.values())) for _ in range(size)]
    events = [layout.event(map(value, layout.fields)) for layout in layouts]
    causes = [None, *(draw.randrange(seq) for seq in range(1, size))]
    return LedgerRun(run_id, [draw.choice([0, -5, 2**53 - 1, 77]) for _ in events], causes, events)


def long_run(run_id: str, size: int) -> LedgerRun:
    """Return a run of many small events."""
    events = [
        RunStarted(kind="live", observes=CONCERNS),
        *(TaskCompleted(f"T{number % 7}") for number in range(1, size)),
    ]
    return LedgerRun(run_id, range(size), [None, *range(size - 1)], events)


def write(path: Path, batches: Sequence[Sequence[LedgerRun]], signers: Sequence[Signer | None]) -> Path:
    """Write a ledger of these batches, each signed by its signer."""
    with Writer(path, ORIGIN):
        pass
    for batch, signer in zip(batches, signers, strict=True):
        with Writer(path, ORIGIN, signer, adopts=True) as writer:
            writer.append(stage_anything(path, batch))
    return path


def plain(sizes: Sequence[int]) -> list[list[LedgerRun]]:
    """Return one batch for each number of events, in two runs where there are enough."""
    cuts = [[size // 2, size - size // 2] if size > 1 else [size] for size in sizes]
    return [
        [made_up_run(f"run-{number}-{at}", part, 10 * number + at) for at, part in enumerate(parts)]
        for number, parts in enumerate(cuts)
    ]


def bases(folder: Path, is_large: bool) -> list[Path]:
    """Write ledgers of several shapes: sizes around a tile's width, signed, half signed, odd text; one (`is_large`)
    with tiles of level 2."""
    shapes: list[tuple[list[int], list[Signer | None]]] = [
        ([], []),
        ([1], [None]),
        ([24, 30], [None] * 2),
        ([3, 4], [KEY] * 2),
        ([5, 6, 7], [None, KEY, KEY]),
        ([5, 6], [KEY, None]),
        ([100, 100, 100], [KEY] * 3),
        ([256, 40], [None] * 2),
        ([255, 260, 1], [None] * 3),
    ]
    found = [write(folder / f"base-{number}", plain(sizes), signers) for number, (sizes, signers) in enumerate(shapes)]
    draw = random.Random(1)
    odd = [
        [odd_run(f"{one}{commit}\u2028{number}", 9, draw) for number, one in enumerate("\x00\U0001f916")]
        for commit in range(2)
    ]
    found.append(write(folder / "base-odd", odd, [None, KEY]))
    if is_large:
        found.append(
            write(
                folder / "base-large",
                [[long_run("long", 65_500)], [made_up_run("more", 300, 2)], [made_up_run("end", 9, 3)]],
                [None] * 3,
            )
        )
    return found


def files_of(path: Path) -> list[Path]:
    return sorted(file for file in path.rglob("*") if file.is_file())


def newest_tiles(old: int, new: int) -> list[str]:
    """Return the names of the tiles that a commit adds, full and partial."""
    before, _ = Edge().extend(bytes(32 * old))
    return [tile.name for tile in before.extend(bytes(32 * (new - old)))[1]]


# --- what a forger who knows the format can do ---


def records_of(path: Path) -> list[CommitRecord]:
    return [
        msgspec.json.decode(file.read_bytes(), type=CommitRecord) for file in sorted((path / "commits").glob("*.json"))
    ]


def tables_of(path: Path) -> list[pa.Table]:
    return [segment.read_table(file) for file in sorted((path / "segments").glob("*.parquet"))]


def note_of(tree: Frontier, signer: Signer | None) -> str:
    checkpoint = checkpoint_of(ORIGIN, tree)
    return str(Note(checkpoint, (signer.sign(checkpoint),) if signer else ()))


Pack = Callable[[pa.Table], bytes]


def rewrite(
    path: Path,
    tables: Sequence[pa.Table],
    signer: Signer | None = None,
    pack: Pack = lambda table: bytes(segment.to_parquet(table)),
) -> None:
    """Write the whole ledger again from other rows, with every hash and note as the format requires."""
    shutil.rmtree(path / "tile", ignore_errors=True)
    (path / "checkpoint").unlink(missing_ok=True)
    edge, previous = Edge(), sha256_hex((path / "ledger.json").read_bytes())
    for before, table in zip(records_of(path), tables, strict=False):
        data = pack(table)
        edge, made = edge.extend(leaves_of(canonical.from_table(table)))
        tree = edge.frontier()
        record = msgspec.structs.replace(
            before,
            previous_sha256=previous,
            segment_sha256=sha256_hex(data),
            segment_bytes=len(data),
            rows=table.num_rows,
            first_run=table.column("run_id")[0].as_py(),
            last_run=table.column("run_id")[-1].as_py(),
            tree_size=tree.size,
            tree_root=tree.root().hex(),
            frontier=tuple(subtree.hex() for subtree in tree.subtrees),
            note=note_of(tree, signer),
        )
        segment_path(path, before.number).write_bytes(data)
        commit_path(path, before.number).write_bytes(canonical.document(record))
        write_tiles(path, made)
        (path / "checkpoint").write_text(record.note, "utf-8")
        previous = sha256_hex(canonical.document(record))


def write_tiles(path: Path, made: Mapping[Tile, bytes]) -> None:
    """Write these tiles, and remove partial tiles whose full tile is among them."""
    for tile, data in made.items():
        (path / tile.name).parent.mkdir(parents=True, exist_ok=True)
        (path / tile.name).write_bytes(data)
        if tile.width == WIDTH:
            shutil.rmtree(path / f"{tile.name}.p", ignore_errors=True)


def chain(path: Path, records: Sequence[dict[str, Any]]) -> None:
    """Write these records, each with the hash of the one before it unless it names one itself."""
    previous = sha256_hex((path / "ledger.json").read_bytes())
    for number, record in enumerate(records):
        data = canonical.document(dict(record) | {"previous_sha256": record["previous_sha256"] or previous})
        commit_path(path, number).write_bytes(data)
        previous = sha256_hex(data)


def unchained(path: Path) -> list[dict[str, Any]]:
    """Return the records as `chain` takes them."""
    return [
        json.loads(file.read_bytes()) | {"previous_sha256": None} for file in sorted((path / "commits").glob("*.json"))
    ]


def with_value(table: pa.Table, name: str, row: int, value: object) -> pa.Table:
    values = table.column(name).to_pylist()
    values[row] = value
    at = SCHEMA.get_field_index(name)
    return table.set_column(at, SCHEMA.field(name), pa.array(values, SCHEMA.field(name).type))


def anchor_at(path: Path, size: int, signer: Signer | None, to: Path) -> Path:
    """Write a checkpoint over the first this many events, as somebody may have kept it."""
    leaves = b"".join(leaves_of(canonical.from_table(table)) for table in tables_of(path))
    to.write_text(note_of(Frontier().extend(leaves[: size * 32]), signer), "utf-8")
    return to


# --- both verdicts ---


class Case(NamedTuple):
    """A ledger to judge. `is_good` is the expected verdict, None if that depends on what was drawn."""

    name: str
    path: Path
    is_good: bool | None
    trusted: VerifierKey | None = None
    anchor: Path | None = None


Make = Callable[[Path, random.Random, Path], Case | None]


class Outcome(NamedTuple):
    """The verdict of `verify`, and the difference between the two verifiers, or between both and the expected verdict.

    `is_stricter`: `verify` only doubts that its own version of the library wrote these bytes for right rows, or that a
    footer and its columns agree, which is more than the format asks.
    """

    is_good: bool
    difference: str
    is_stricter: bool = False


Place = tuple[str, int | None, str | None, int | None]


def judged(case: Case) -> Outcome:
    """Judge the case by both verifiers."""
    ours, theirs = by_package(case), by_independent(case)
    is_about_bytes = ours is not None and ("found other bytes" in ours[1] or "found no segment (" in ours[1])
    if is_about_bytes and theirs is None and case.is_good is None:
        return Outcome(False, "", is_stricter=True)
    if (ours is None) != (theirs is None):
        return Outcome(
            ours is None, f"{case.name}: verify says {ours or 'good'}, the independent verifier {theirs or 'good'}"
        )
    if ours is not None and theirs is not None and not is_same_place(ours[0], theirs[0]):
        return Outcome(False, f"{case.name}: verify names {ours}, the independent verifier {theirs}")
    if case.is_good is not None and case.is_good != (ours is None):
        return Outcome(
            ours is None, f"{case.name}: expected {'good' if case.is_good else 'damage'}, both say {ours or 'good'}"
        )
    return Outcome(ours is None, "")


def is_same_place(one: Place, other: Place) -> bool:
    """Return whether both name the same file, and the same commit, run and seq where both name them."""
    return one[0] == other[0] and all(a == b or a is None or b is None for a, b in zip(one[1:], other[1:], strict=True))


def by_package(case: Case) -> tuple[Place, str] | None:
    asked = Asked(trusted=case.trusted, anchor=read_anchor(case.anchor) if case.anchor else None)
    try:
        report = verify(case.path, asked=asked)
    except NotALedger as error:
        return ("", None, None, None), str(error)
    if report.ok:
        return None
    first = report.problems[0]
    return (first.where, first.commit, first.run, first.seq), str(first)


def by_independent(case: Case) -> tuple[Place, str] | None:
    module = independent()
    key = module.read_key(str(case.trusted)) if case.trusted else None
    try:
        independent("independent_chain").verifier_of(case.path, key, case.anchor, event_types()).verify()
    except module.ProblemError as error:
        named = Problem(error.where, "", "", run=error.run)  # a report names both in printable characters
        return (named.where, error.commit, named.run, error.seq), str(error)
    return None
