"""Stage batches of runs: write each as a segment, from which a writer commits it.

Any number of workers may stage; needs no lock and no order, and what is staged is not yet part of the ledger.
"""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import pyarrow as pa

from fsar_ledger.base.errors import CommitTooLarge, InvalidRun
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.blocks import Block, blocks_of
from fsar_ledger.ledger.rows.bounds import (
    MAX_ROWS,
    MAX_SEGMENT_BYTES,
    MAX_TEXT_BYTES,
    has_more_text_than,
    text_bytes,
)
from fsar_ledger.ledger.rows.check import disordered, unprintable
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_hashed
from fsar_ledger.ledger.rows.layout import read_layout
from fsar_ledger.ledger.rows.releases import RELEASE
from fsar_ledger.ledger.rows.runs import overlong, refusal, unreadable
from fsar_ledger.ledger.rows.schema import FINGERPRINT
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import staged_path


class Staged(msgspec.Struct, frozen=True):
    """What the parent must know of a segment that waits to be committed.

    Units: `segment_bytes` bytes, `rows` events. `leaves` are the packed RFC 6962 leaf hashes, 32 bytes per row.
    `blocks` are those of the rows; `goes_on` are the runs of which later commits may hold more.
    `release` is the one whose events and columns these are.
    """

    segment_sha256: str
    segment_bytes: int
    rows: int
    leaves: bytes
    blocks: tuple[Block, ...] = ()
    goes_on: tuple[str, ...] = ()
    release: str = RELEASE
    schema_sha256: str = FINGERPRINT


def stage(ledger: Path, runs: Sequence[LedgerRun]) -> Staged:
    """Encode these runs and write them to the staging folder, durably; they are not yet part of the ledger.

    Needs no lock and no order. Workers may stage at the same time, but while a Writer is open: one that is alone when
    it opens removes what is staged and not committed. The same runs give the same file.

    Raises:
        CommitTooLarge: They are more than one commit may hold (see `bounds`). Nothing was written.
        InvalidRun: There are no runs, or one cannot be encoded (see `codec.encode`), has unprintable text (see
            `check.unprintable`), events in a wrong order (see `check.disordered`) or unreadable parameters (see
            `runs.unreadable`). Nothing was written.
        WriteFailed: The disk refused; nothing is left behind.
    """
    if not runs:
        raise InvalidRun("found no runs to stage, expected at least 1")
    table, leaves = encode_hashed(runs)
    if flaw := unprintable(table):
        raise InvalidRun(f"{flaw}; give it another name")
    if flaw := disordered(table) or unreadable(runs):
        raise refusal(flaw)
    return stage_rows(ledger, runs, table, leaves)


def stage_rows(ledger: Path, runs: Sequence[LedgerRun], table: pa.Table, leaves: bytes) -> Staged:
    """Stage encoded runs without a check of their names and order, as 0.1.0 did. Raises: As `stage`."""
    data = segment.to_parquet(table)
    sizes = [(table.num_rows, MAX_ROWS, "events"), (data.size, MAX_SEGMENT_BYTES, "bytes")]
    if has_more_text_than(table, MAX_TEXT_BYTES):
        sizes.append((text_bytes(table), MAX_TEXT_BYTES, "bytes of text"))
    for size, most, what in sizes:
        if size > most:
            raise CommitTooLarge(
                f"found {size} {what} in {len(runs)} runs, expected at most {most} in one commit; commit fewer runs "
                "at once"
            )
    if flaw := overlong(runs):
        raise refusal(flaw)
    try:
        read_layout(data.to_pybytes())
    except ValueError as error:
        raise CommitTooLarge(
            f"found {error} in a segment of {len(runs)} runs, so no reader would take it; commit fewer runs at once"
        ) from error
    staged = Staged(
        sha256_hex(data),
        data.size,
        table.num_rows,
        leaves,
        tuple(blocks_of(table)),
        tuple(sorted(run.run_id for run in runs if run.goes_on)),
    )
    path = staged_path(ledger, staged.segment_sha256)
    with disk.refusals(path, "writing a segment"):
        disk.write_durably(path, memoryview(data))
    return staged
