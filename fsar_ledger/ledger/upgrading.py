"""Write a ledger of format 1 as one of format 2: the same events, commits, signatures and roots."""

import base64
from collections.abc import Callable
from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.chain.append import ChainWriter
from fsar_ledger.ledger.opening import version_of
from fsar_ledger.ledger.rows.blocks import blocks_of
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.append import Staged
from fsar_ledger.ledger.store.paths import staged_path
from fsar_ledger.ledger.store.read import LedgerView, open_ledger
from fsar_ledger.ledger.store.record import VERSION, CommitRecord
from fsar_ledger.ledger.store.view import Head

Progress = Callable[[int, int], None]


def upgrade(ledger: Path, into: Path, progress: Progress | None = None) -> Head:
    """Write the ledger into this new folder in format 2, commit by commit; return its head.

    Segments are copied byte for byte, and each record keeps its signature. The same call goes on after an interruption.
    `progress` is called with (commits done, commits in all).

    Raises:
        UsageError: The ledger has format 2 already, or `into` holds other commits than these.
        LedgerCorrupted: Rows do not lead to the recorded root, or a segment is not as committed.
        NotALedger, FormatVersionMismatch, WriteFailed: As `ChainWriter` and `open_ledger`.
    """
    if version_of(ledger) != VERSION:
        raise UsageError(f"{ledger}: found a ledger of format {version_of(ledger)}, expected one of format {VERSION}")
    view = open_ledger(ledger)
    with ChainWriter(into, view.manifest.origin) as writer:
        done = _require_begun(view, into, writer)
        for record in view.records[done:]:
            writer.append(_copied(view, record, into), _signature(record))
            if writer.head.root != record.tree_root:
                raise LedgerCorrupted(
                    f"{view.segment(record.number)}: commit {record.number}: found rows that lead to root "
                    f"{writer.head.root}, expected {record.tree_root} as committed; run fsar-ledger verify, and remove "
                    f"{into}"
                )
            if progress is not None:
                progress(record.number + 1, len(view.records))
        return writer.head


def _require_begun(view: LedgerView, into: Path, writer: ChainWriter) -> int:
    """Return how many of these commits the new ledger holds. Raises: UsageError if it holds others."""
    head = writer.head
    known = [(record.tree_size, record.tree_root) for record in view.records[: head.commits]]
    if head.commits and (head.commits > len(view.records) or known[-1] != (head.size, head.root)):
        raise UsageError(f"{into}: found a ledger of other events, expected a free path; give another path")
    return head.commits


def _copied(view: LedgerView, record: CommitRecord, into: Path) -> Staged:
    """Copy the segment of this commit to the new ledger's staging folder. Raises: LedgerCorrupted, WriteFailed."""
    path = view.segment(record.number)
    with disk.refusals(path, "reading a segment"):
        data = disk.read_large(path, record.segment_bytes)
    target = staged_path(into, record.segment_sha256)
    with disk.refusals(target, "writing a segment"):
        disk.write_durably(target, data)
    table = view.table(record.number)
    return Staged(
        record.segment_sha256,
        record.segment_bytes,
        record.rows,
        record.first_run,
        record.last_run,
        view.leaves(record.number),
        tuple(blocks_of(table)),
        (),
        record.release,
        record.schema_sha256,
    )


def _signature(record: CommitRecord) -> str:
    """Return the signature of the record's note, as a record of format 2 holds it; empty if there is none."""
    signatures = record.signed_note().signatures
    return base64.b64encode(signatures[0].key_id + signatures[0].data).decode() if signatures else ""
