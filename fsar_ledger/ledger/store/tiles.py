"""Write the hashes of a ledger's tree as files for any client of C2SP tlog-tiles."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, option
from fsar_ledger.ledger.log.tiles import WIDTH, Edge, Tile, partial_tiles
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import CHECKPOINT, require_outside
from fsar_ledger.ledger.store.read import View


def write_tiles(view: View, out: Path, progress: Callable[[int, int], None] | None = None) -> int:
    """Write every tile of the tree, and its checkpoint, into a new folder; return how many.

    The hashes are those of the rows, each of which is read and hashed. `progress` is called with the segments that were
    hashed, and their number.

    Raises:
        UsageError: Something is at `out`, or it lies inside a ledger.
        LedgerCorrupted: The rows do not lead to the recorded root, or a segment is not as committed.
        WriteFailed: The folder cannot be written; nothing is left there.
    """
    if os.path.lexists(out):
        raise UsageError(f"{option('out', out)}: found something there, expected a free path for a new folder")
    require_outside(out, option("out", out))
    work = disk.temporary_name(out)
    try:
        with disk.refusals(out, "writing tiles"):
            work.mkdir(parents=True)
        count, edge = 0, Edge()
        for done, table in enumerate(view.tables(), start=1):
            edge, made = edge.extend(canonical.leaves(table))
            count += _write(work, out, {tile: data for tile, data in made.items() if tile.width == WIDTH})
            if progress is not None:
                progress(done, len(view.releases))
        if edge.frontier().root().hex() != view.head.root:
            raise LedgerCorrupted(
                f"{view.path}: found rows that lead to root {edge.frontier().root().hex()}, expected "
                f"{view.head.root} as committed; run fsar-ledger verify"
            )
        count += _write(work, out, {tile: edge.partial[tile.level] for tile in partial_tiles(edge.size)})
        note = view.note()
        with disk.refusals(out, "writing tiles"):
            if note is not None:
                (work / CHECKPOINT).write_bytes(str(note).encode())
            os.rename(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    return count


def _write(work: Path, out: Path, tiles: dict[Tile, bytes]) -> int:
    """Write these tiles. Raises: WriteFailed."""
    with disk.refusals(out, "writing tiles"):
        for tile, data in tiles.items():
            file = work / tile.name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
    return len(tiles)
