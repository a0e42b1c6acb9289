"""The files derived from the commits: the tiles of the Merkle tree, and `checkpoint`, the newest note.

They are written after the commit, tiles first, so a crash leaves them at most one commit behind; the next writer
catches up. A partial tile stays until the full tile is there, as C2SP tlog-tiles requires, so that each published tree
size has its own.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.tiles import HEIGHT, TILE, WIDTH, Edge, Tile, partial_tiles
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import CHECKPOINT, STAGING, commit_file
from fsar_ledger.ledger.store.problem import Problem, refusal
from fsar_ledger.ledger.store.record import CommitRecord

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.read import LedgerView


def write_derived(ledger: Path, before: Edge, made: Mapping[Tile, bytes], record: CommitRecord) -> None:
    """Write the tiles that `before.extend` made for this commit, and its checkpoint, durably.

    Doing it twice changes nothing.

    Raises:
        OSError: The disk refused; what is missing can be written again.
    """
    disk.write_files({ledger / tile.name: data for tile, data in made.items()}, ledger / STAGING)
    disk.write_files({ledger / CHECKPOINT: record.note.encode()}, ledger / STAGING)
    _remove_outgrown(ledger, before.size, record)


def _remove_outgrown(ledger: Path, before: int, record: CommitRecord) -> None:
    """Remove, durably, the partial tiles of the tree of `before` events whose full tile came with this commit.

    Raises: OSError.
    """
    for tile in partial_tiles(before):
        if (tile.number + 1) * WIDTH <= record.tree_size >> HEIGHT * tile.level:
            disk.remove_folder(ledger / f"{Tile(tile.level, tile.number).name}.p")


def check_folders(ledger: Path, tiles: Iterable[Tile]) -> None:
    """Require that no folder of these tiles is a link, which would lead a writer to files outside the ledger.

    Raises: LedgerCorrupted if one is.
    """
    for folder in sorted({ledger / parent for tile in tiles for parent in Path(tile.name).parents if parent.name}):
        if folder.is_symlink():
            raise LedgerCorrupted(
                f"{folder}: found a link, expected a folder of tiles; take it away and run fsar-ledger recover"
            )


def catch_up(view: "LedgerView") -> Edge:
    """Bring the derived files up to the view's head, durably; return the edge of its tree.

    The last writer may have stopped at any moment.

    Raises:
        LedgerCorrupted: They were altered, or are further behind than a crash leaves them; or they are behind and the
            newest segment is not as committed.
        WriteFailed: The disk refused.
    """
    if not view.records:
        return Edge()
    *earlier, last = view.records
    found = read_checkpoint(view.path)
    before = earlier[-1] if earlier else None
    if found == last.note:
        with disk.refusals(view.path / TILE, "removing outgrown tiles"):
            _remove_outgrown(view.path, before.tree_size if before else 0, last)
        return edge_at(view.path, last.tree())
    if found != (before.note if before else None):
        raise LedgerCorrupted(
            f"{view.path / CHECKPOINT}: found {'no file' if found is None else 'another note'}, expected that of the "
            "newest commit; run fsar-ledger verify, "
            "and fsar-ledger recover if only derived files are damaged"
        )
    edge = edge_at(view.path, before.tree() if before else Frontier())
    after, made = edge.extend(view.leaves(last.number))
    if after.frontier() != last.tree():
        raise LedgerCorrupted(
            f"{view.segment(last.number)}: commit {last.number}: found rows that lead to root "
            f"{after.frontier().root().hex()}, "
            f"expected {last.tree_root} as committed; run fsar-ledger verify"
        )
    check_folders(view.path, made)
    with disk.refusals(view.path / TILE, "writing tiles"):
        write_derived(view.path, edge, made, last)
    return after


def read_checkpoint(ledger: Path) -> str | None:
    """Read the note in the file `checkpoint`; None if there is none. Raises: LedgerCorrupted if it cannot be read."""
    path = ledger / CHECKPOINT
    try:
        return disk.read_document(path).decode()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise LedgerCorrupted(
            f"{path}: the checkpoint cannot be read ({reason}), expected the newest note; run fsar-ledger recover"
        ) from error


def check_checkpoint(ledger: Path, records: Sequence[CommitRecord]) -> tuple[list[Problem], bool]:
    """Compare the file `checkpoint` with the note of the newest commit.

    Returns the problems, and whether it is the note of the commit before, which a crash may leave.
    """
    try:
        found = read_checkpoint(ledger)
    except LedgerCorrupted as error:
        return [Problem(CHECKPOINT, f"no note {refusal(ledger / CHECKPOINT, error)}", "the newest one")], False
    notes = [None, *(record.note for record in records)]
    if found == notes[-1]:
        return [], False
    if len(notes) > 1 and found == notes[-2]:
        return [], True
    newest = records[-1].number if records else None
    expected = (
        "no note, as there is no commit" if newest is None else f"the note in {commit_file(newest)}, the newest record"
    )
    return [Problem(CHECKPOINT, "no file" if found is None else f"{found!r:.400}", expected, commit=newest)], False


def tile_reader(ledger: Path) -> Callable[[Tile], bytes]:
    """Return a reader of the ledger's tiles, each read once. For a partial tile that is gone it takes the full one.

    The reader raises LedgerCorrupted if a tile is missing.
    """
    found: dict[Tile, bytes] = {}

    def read(tile: Tile) -> bytes:
        if tile not in found:
            found[tile] = _read(ledger, tile)
        return found[tile]

    return read


def _read(ledger: Path, tile: Tile) -> bytes:
    data: bytes | None = None
    for name in dict.fromkeys((tile.name, Tile(tile.level, tile.number).name)):
        try:
            data = disk.read_document(ledger / name)
        except FileNotFoundError:
            continue
        except OSError as error:
            raise LedgerCorrupted(
                f"{ledger / name}: the tile cannot be read ({error.strerror}); run fsar-ledger recover, which derives "
                "it again"
            ) from error
        if len(data) >= tile.width * HASH_BYTES:
            return data[: tile.width * HASH_BYTES]
    found = "no file" if data is None else f"{len(data)} bytes"
    raise LedgerCorrupted(
        f"{ledger / tile.name}: found {found}, expected {tile.width} hashes of {HASH_BYTES} bytes; run fsar-ledger "
        "recover, which derives them again"
    )


def edge_at(ledger: Path, frontier: Frontier) -> Edge:
    """Rebuild the edge of the tree with this frontier from its partial tiles.

    Raises:
        LedgerCorrupted: A tile is missing or does not agree with the frontier.
    """
    read = tile_reader(ledger)
    partial = {tile.level: read(tile) for tile in partial_tiles(frontier.size)}
    edge = Edge(frontier.size, tuple(partial.get(level, b"") for level in range(max(partial, default=-1) + 1)))
    if edge.frontier() != frontier:
        raise LedgerCorrupted(
            f"{ledger / TILE}: the partial tiles of a tree of {frontier.size} events do not agree with its commit "
            "record; "
            "run fsar-ledger verify, and fsar-ledger recover if only they are damaged"
        )
    return edge


def tile_files(ledger: Path) -> Iterator[str]:
    """Name every file under `tile/`, including links and other things; none if `tile/` is a link.

    Raises:
        OSError: A folder cannot be read, or there are too many names.
    """
    seen = 0
    folders = [TILE] if (ledger / TILE).is_dir() and not (ledger / TILE).is_symlink() else []
    while folders:
        found: list[os.DirEntry[str]] = []
        folder = folders.pop()
        with suppress(FileNotFoundError):  # a writer has removed outgrown tiles meanwhile
            found = disk.entries(ledger / folder)
        seen += len(found)
        if seen > disk.MAX_NAMES:
            raise OSError(0, f"it holds more than {disk.MAX_NAMES} names", TILE)
        for entry in found:
            name = f"{folder}/{entry.name}"
            if entry.is_dir(follow_symlinks=False):
                folders.append(name)
            else:
                yield name
