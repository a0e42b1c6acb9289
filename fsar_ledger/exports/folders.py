"""Exports that are folders: a ledger's rows as a Delta table (delta.io), the hashes of its tree as C2SP tlog-tiles.

The files of a Delta table are the ledger's own segments, linked and not copied. The log of such a table lies beside its
files, and the folder of a ledger holds nothing but its own, so the table is a folder of its own. Segments never change,
and removing a link leaves the other, so neither harms the other.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, WriteFailed, option
from fsar_ledger.ledger.log.pack import WIDTH, Edge, Tile, partial_tiles
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import CHECKPOINT, require_outside, segment_name
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import log_of, views_of

from . import Written

DELTA, TILES = "writing a Delta table", "writing tiles"


def _require_free(out: Path) -> None:
    """Raise a UsageError if something is at this path, or it lies inside a ledger."""
    if os.path.lexists(out):
        raise UsageError(f"{option('out', out)}: found something there, expected a free path for a new folder")
    require_outside(out, option("out", out))


@contextmanager
def _whole_folder(out: Path, doing: str) -> Iterator[Path]:
    """Yield a new folder, which comes to this path once it is complete; else nothing is left. Raises: WriteFailed."""
    work = disk.temporary_name(out)
    try:
        with disk.refusals(out, doing):
            work.mkdir(parents=True)
        yield work
        with disk.refusals(out, doing):
            os.rename(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


def write_delta(out: Path, view: View) -> Written:
    """Write a new folder with the segments of the ledger, one more of the rows of its journal, and `_delta_log`.

    Raises:
        UsageError: Something is at `out`, it lies inside a ledger, or the ledger has no events.
        LedgerCorrupted: A segment is not as committed.
        WriteFailed: The folder cannot be written; nothing is left there.
        ImportError: There is no library `deltalake`.
    """
    _require_free(out)
    if not view.head.events:
        raise UsageError(f"{view.path}: found no events, expected some: a Delta table has the columns of its files")
    with _whole_folder(out, DELTA) as work:
        linked = sum(_place(view, number, work, out) for number in range(len(view.releases)))
        _make_log(work, out, view.head.root)
    placed = sum(len(one.chain.placed) for one in views_of(view))
    journal = sum(one.head.size - one.chain.placed_size for one in views_of(view))
    told = f"{linked:,} segments are hard links into the ledger, {placed - linked:,} are copies"
    return Written(view.head.events, (told, f"{journal:,} events of the journal are in a file of their own"))


def _place(view: View, number: int, work: Path, out: Path) -> bool:
    """Put this segment into the folder; return whether it is a link into the ledger. Raises: As `write_delta`."""
    segment = view.segment(number)
    file = work / Path(segment_name(view.first(number), view.end(number))).name
    with disk.refusals(out, DELTA):
        try:
            os.link(segment, file)
        except OSError:  # another file system, or one without links
            shutil.copyfile(segment, file)
            return False
    return any(segment.is_relative_to(one.path) for one in views_of(view))


def _make_log(work: Path, out: Path, root: str) -> None:
    """Make the log of the table of these files. Raises: WriteFailed, ImportError."""
    from deltalake import convert_to_deltalake
    from deltalake.exceptions import DeltaError

    try:
        convert_to_deltalake(work, name="events", description=f"The events of the ledger with the root {root}")
    except (DeltaError, OSError) as error:
        raise WriteFailed(
            f"{out}: cannot be written ({error}); nothing was left there: choose another place"
        ) from error


def write_tiles(view: View, out: Path, progress: Callable[[int, int], None] | None = None) -> int:
    """Write every tile of the tree, and its checkpoint, into a new folder; return how many.

    The hashes are those of the rows, each of which is read and hashed. `progress` is called with the segments that were
    hashed, and their number.

    Raises:
        UsageError: Something is at `out`, or it lies inside a ledger.
        LedgerCorrupted: The rows do not lead to the recorded root, or a segment is not as committed.
        WriteFailed: The folder cannot be written; nothing is left there.
    """
    _require_free(out)
    view = log_of(view)
    with _whole_folder(out, TILES) as work:
        count, edge = 0, Edge()
        for done, table in enumerate(view.tables(), start=1):
            edge, made = edge.extend(canonical.leaves(table))
            count += _write_files(work, out, {tile: data for tile, data in made.items() if tile.width == WIDTH})
            if progress is not None:
                progress(done, len(view.releases))
        if edge.frontier().root().hex() != view.head.root:
            raise LedgerCorrupted(
                f"{view.path}: found rows that lead to root {edge.frontier().root().hex()}, expected "
                f"{view.head.root} as committed; run fsar-ledger verify"
            )
        count += _write_files(work, out, {tile: edge.partial[tile.level] for tile in partial_tiles(edge.size)})
        if (note := view.note()) is not None:
            with disk.refusals(out, TILES):
                (work / CHECKPOINT).write_bytes(str(note).encode())
    return count


def _write_files(work: Path, out: Path, tiles: dict[Tile, bytes]) -> int:
    """Write these tiles. Raises: WriteFailed."""
    with disk.refusals(out, TILES):
        for tile, data in tiles.items():
            file = work / tile.name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
    return len(tiles)
