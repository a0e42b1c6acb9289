"""Rows of a journal, or of some segments, as columns of one segment."""

import atexit
import shutil
import tempfile
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.json

from fsar_ledger.base.errors import LedgerCorrupted, WriteFailed
from fsar_ledger.ledger.log.hashing import HASH_BYTES, sha256_hex
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.compiled import plain_table
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import staged_path
from fsar_ledger.ledger.store.staging import Staged

_PARSE = pyarrow.json.ParseOptions(
    explicit_schema=pa.schema([field.with_nullable(True) for field in SCHEMA]),
    unexpected_field_behavior="error",
    newlines_in_values=False,
)
_BLOCK_BYTES = 1 << 24
_folders: list[str] = []  # of this process, for rows of journals


def table_of(path: Path, lines: bytes) -> pa.Table:
    """Return these rows of the journal at this path, the canonical bytes of each and a line feed, as a table.

    It has the columns of `SCHEMA`, or of `CODED_SCHEMA`.

    Raises: LedgerCorrupted if a row is not the canonical JSON of such columns.
    """
    if not lines:
        return SCHEMA.empty_table()
    if (plain := plain_table(lines)) is not None:
        return plain
    rows = lines.split(b"\n")[:-1]
    try:
        table = pyarrow.json.read_json(
            BytesIO(lines),
            pyarrow.json.ReadOptions(use_threads=False, block_size=max(_BLOCK_BYTES, *map(len, rows)) + 1),
            _PARSE,
        ).cast(SCHEMA)
        again = canonical.from_table(table.combine_chunks())
    except (pa.ArrowException, ValueError) as error:
        raise LedgerCorrupted(
            f"{path}: found rows that are no events ({error!s:.200}); run fsar-ledger verify, and restore the file"
        ) from error
    for number, (row, line) in enumerate(zip(rows, again, strict=True)):
        if line != row:
            raise LedgerCorrupted(
                f"{path}: row {number}: found {row!r:.200}, expected canonical JSON of the columns of events; restore "
                "the file"
            )
    return table.combine_chunks()


class UnstagedSegment(NamedTuple):
    """A segment in memory, which is not staged yet: its bytes, and what a writer must know of it."""

    data: pa.Buffer
    staged: Staged


def made_of(table: pa.Table, leaves: bytes) -> UnstagedSegment:
    """Make a segment of these rows, of runs that a ledger holds, with these packed leaf hashes."""
    data = segment.to_parquet(table)
    return UnstagedSegment(data, Staged(sha256_hex(data), data.size, table.num_rows, leaves))


def stage_made(ledger: Path, made: UnstagedSegment) -> None:
    """Write a segment durably to the staging folder. Raises: WriteFailed if the disk refused."""
    path = staged_path(ledger, made.staged.segment_sha256)
    with disk.refusals(path, "writing a segment"):
        disk.write_durably(path, memoryview(made.data))


def require_staged(ledger: Path, staged: Staged) -> None:
    """Require that the staging folder has this segment. Raises: WriteFailed if not, or if the disk refused."""
    path = staged_path(ledger, staged.segment_sha256)
    with disk.refusals(path, "reading what was staged"):
        data = disk.read_large(path, staged.segment_bytes)
    if sha256_hex(data) != staged.segment_sha256 or staged.rows * HASH_BYTES != len(staged.leaves):
        raise WriteFailed(
            f"{path}: found another file than was staged, expected {staged.segment_bytes} bytes of that SHA-256; "
            "stage it again"
        )


def materialized(table: pa.Table) -> Path:
    """Write these rows as a segment into a folder of this process, and return it."""
    if not _folders:
        _folders.append(tempfile.mkdtemp(prefix="fsar-ledger-"))
        atexit.register(shutil.rmtree, _folders[0], ignore_errors=True)
    data = segment.to_parquet(table)
    path = Path(_folders[0]) / f"{sha256_hex(data)}.parquet"
    if not path.exists():
        path.write_bytes(data)
    return path
