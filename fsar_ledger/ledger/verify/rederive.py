"""Compare tiles and checkpoint with verified rows, and make them again where they are wrong: a part of `recover`."""

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.log.merkle import consistency_proof, is_consistent
from fsar_ledger.ledger.log.note import Checkpoint, Note, parse_note
from fsar_ledger.ledger.log.tiles import HEIGHT, TILE, WIDTH, Edge, Tile, tile_named
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import read_checkpoint, tile_files
from fsar_ledger.ledger.store.paths import CHECKPOINT, STAGING
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import LedgerView
from fsar_ledger.ledger.store.view import Head
from fsar_ledger.ledger.verify.notes import Nodes

SetAside = Callable[[str], None]
"""Moves the file with this name within the ledger out of it, to where nothing is lost."""


class Redo(msgspec.Struct, frozen=True):
    """The commit from which tiles must be derived again, and the edge of the tree before it."""

    commit: int
    before: Edge = Edge()


class _Made(msgspec.Struct, frozen=True):
    """A tile, and the commit that made it."""

    tile: Tile
    data: bytes
    by: Redo


class TilePlan:
    """Compares the tiles with those of a tree that grows commit by commit, and finds what to make again."""

    def __init__(self, ledger: Path) -> None:
        self._ledger = ledger
        self._wrong: list[Redo] = []
        self._partial: dict[tuple[int, int], list[_Made]] = {}  # whose full tile is still to come

    def add(self, by: Redo, made: Mapping[Tile, bytes]) -> list[_Made]:
        """Add the tiles that a commit made; return the full ones."""
        full = []
        for tile, data in made.items():
            if tile.width < WIDTH:
                self._partial.setdefault((tile.level, tile.number), []).append(_Made(tile, data, by))
                continue
            self._partial.pop((tile.level, tile.number), None)
            full.append(_Made(tile, data, by))
        return full

    def compare(self, made: list[_Made]) -> None:
        """Note which of these are not on disk as they should be."""
        self._wrong += [one.by for one in made if not is_as(self._ledger, one.tile.name, one.data)]

    def redo(self) -> Redo | None:
        """Return where to begin so that everything is right afterwards; None if everything is."""
        return min(self._wrong, key=lambda by: by.commit, default=None)

    def partial(self) -> list[_Made]:
        """Return the partial tiles that must be there."""
        return [one for made in self._partial.values() for one in made]


def is_as(ledger: Path, name: str, data: bytes) -> bool:
    """Return whether the file of this name is there with these bytes, in the ledger itself and not behind a link."""
    try:
        return (
            os.path.realpath(ledger / name) == os.path.join(os.path.realpath(ledger), name)
            and disk.read_document(ledger / name) == data
        )
    except OSError:
        return False


def derive(view: LedgerView, redo: Redo | None, set_aside: SetAside) -> list[str]:
    """Derive the tiles from `redo` on and the checkpoint from the rows, durably; return the names of those written.

    Each is written once the rows gave the tree of its commit record. What is in its place is set aside, unless it is an
    older note, which a commit record holds too.

    Raises:
        LedgerCorrupted: The rows are not those that were verified.
        OSError: The disk refused; what is missing can be derived again.
    """
    written: list[str] = []
    plan = TilePlan(view.path)
    edge = redo.before if redo else Edge()
    for number in range(redo.commit if redo else len(view.records), len(view.records)):
        after, made = edge.extend(view.leaves(number))
        if after.frontier() != view.records[number].tree():
            raise LedgerCorrupted(
                f"{view.segment(number)}: commit {number}: found other rows than a moment ago, expected nobody else "
                "to write; run it again"
            )
        written += put(view.path, {one.tile.name: one.data for one in plan.add(Redo(number, edge), made)}, set_aside)
        edge = after
    written += put(view.path, {one.tile.name: one.data for one in plan.partial()}, set_aside)
    if not view.records:
        return written
    *older, newest = [record.note for record in view.records]
    is_older = _checkpoint(view.path) in older
    return written + put(view.path, {CHECKPOINT: newest.encode()}, _leave if is_older else set_aside)


def _leave(name: str) -> None:
    """Let the file be replaced, because nothing is lost by it."""


def put(ledger: Path, files: Mapping[str, bytes], set_aside: SetAside) -> list[str]:
    """Write each file that is not there with these bytes, durably; return their names. Raises: OSError."""
    wrong = {name: data for name, data in files.items() if not is_as(ledger, name, data)}

    def make_way(path: Path) -> None:
        if os.path.lexists(path):
            set_aside(str(path.relative_to(ledger)))

    if wrong:
        disk.make_folder(ledger / STAGING)
    disk.write_files({ledger / name: data for name, data in wrong.items()}, ledger / STAGING, make_way)
    return list(wrong)


def begins_with(nodes: Nodes, then: Checkpoint, size: int, root: str) -> bool:
    """Return whether these hashes prove that a checkpoint's tree begins with the tree of so many events, at least one.

    Only the proof counts, not the hashes as such.
    """
    if not 0 < size <= then.size:
        return False
    try:
        proof = consistency_proof(nodes(then.size), size, then.size)
    except LedgerCorrupted:
        return False
    return is_consistent(size, bytes.fromhex(root), then.size, then.root, proof)


# --- what the tree must not have ---


def tile_strays(ledger: Path, head: Head, partial: list[_Made]) -> list[str]:
    """Name every file below `tile/` that is not a tile of this tree, such as outgrown partial tiles and links."""
    expected = {one.tile.name for one in partial}
    return [name for name in tile_files(ledger) if name not in expected and not _is_full(tile_named(name), head.size)]


def is_tile(name: str) -> bool:
    """Return whether this is the name of a tile of some tree, which no other file of a ledger has."""
    return name.startswith(f"{TILE}/") and tile_named(name) is not None


def grown_beyond(ledger: Path, head: Head, origin: str) -> Iterator[Problem]:
    """Yield a problem for what exists only because the ledger once had more commits, which are durable first."""
    expected = (
        f"nothing of a tree of more than the {head.size} events that are committed: the newest commits were removed"
    )
    note = checkpoint_note(ledger)
    if (
        note is not None
        and (note.checkpoint.origin, note.checkpoint.root.hex()) != (origin, head.root)
        and note.checkpoint.size > head.size
    ):
        yield Problem(CHECKPOINT, f"a checkpoint of {note.checkpoint.size} events", expected, commit=head.commits)
    beyond = [
        name
        for name in tile_files(ledger)
        if (tile := tile_named(name)) is not None
        and tile.number * WIDTH + tile.width > head.size >> HEIGHT * tile.level
    ]
    if beyond:
        yield Problem(
            beyond[0],
            f"a tile{f' (and {len(beyond) - 1} more)' if len(beyond) > 1 else ''}",
            expected,
            commit=head.commits,
        )


def checkpoint_note(ledger: Path) -> Note | None:
    """Return the note in the file `checkpoint`; None if there is none."""
    text = _checkpoint(ledger)
    try:
        return None if text is None else parse_note(CHECKPOINT, text)
    except LedgerCorrupted:
        return None


def _checkpoint(ledger: Path) -> str | None:
    try:
        return read_checkpoint(ledger)
    except LedgerCorrupted:
        return None


def _is_full(tile: Tile | None, size: int) -> bool:
    """Return whether this is a full tile of a tree of this size."""
    return tile is not None and tile.width == WIDTH and (tile.number + 1) * WIDTH <= size >> HEIGHT * tile.level
