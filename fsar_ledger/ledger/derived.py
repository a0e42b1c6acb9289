"""What is derived from the commits and lies beside them: the tiles of the Merkle tree, and `checkpoint`, the newest note.

They are written after the commit, tiles first, so a crash leaves them one commit behind at most; the next writer goes on.
Partial tiles stay until the full tile is there, as C2SP tlog-tiles asks, so each published tree size keeps its own.
"""

from collections.abc import Mapping
from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger import disk
from fsar_ledger.ledger.merkle import Frontier
from fsar_ledger.ledger.read import LedgerView
from fsar_ledger.ledger.record import STAGING
from fsar_ledger.ledger.tiles import HEIGHT, TILE, WIDTH, Edge, Tile, edge_at

CHECKPOINT = "checkpoint"


def write_derived(ledger: Path, before: Edge, made: Mapping[Tile, bytes], note: str) -> None:
    """The tiles that `before.extend` made and the checkpoint are there, durably. Doing it twice is as good.

    Raises:
        OSError: The disk refused; what is missing can be written again.
    """
    disk.write_files({ledger / tile.name: data for tile, data in made.items()}, ledger / STAGING)
    disk.write_files({ledger / CHECKPOINT: note.encode()}, ledger / STAGING)
    for level, hashes in enumerate(before.partial):
        full = Tile(level, (before.size >> HEIGHT * level) // WIDTH)
        if hashes and full in made:
            disk.remove_folder(ledger / f"{full.name}.p")


def catch_up(view: LedgerView) -> Edge:
    """The derived files are those of the view's head, durably, whatever moment the last writer was interrupted at; the edge of its tree.

    Raises:
        LedgerCorrupted: They are further behind than a crash leaves them, or were altered.
        WriteFailed: The disk refused.
    """
    if not view.records:
        return Edge()
    *earlier, last = view.records
    found = read_checkpoint(view.path)
    if found == last.note:
        return edge_at(view.path, last.tree())
    before = earlier[-1] if earlier else None
    if found != (before.note if before else None):
        raise LedgerCorrupted(
            f"{view.path / CHECKPOINT}: found {'no file' if found is None else 'another note'}, expected that of the newest commit; run fsar-ledger verify, "
            "and fsar-ledger recover if only derived files are damaged"
        )
    edge = edge_at(view.path, before.tree() if before else Frontier())
    with disk.refusals(view.path / TILE, "writing tiles"):
        after, made = edge.extend(view.leaves(len(view.records) - 1))
        write_derived(view.path, edge, made, last.note)
    return after


def read_checkpoint(ledger: Path) -> str | None:
    """The note in the file `checkpoint`; None if there is none. Raises: LedgerCorrupted if it cannot be read."""
    path = ledger / CHECKPOINT
    try:
        return disk.read_document(path).decode()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise LedgerCorrupted(f"{path}: the checkpoint cannot be read ({reason}), expected the newest note; run fsar-ledger recover") from error
