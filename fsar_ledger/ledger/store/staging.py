"""Encode runs for a ledger: as a staged segment, or as rows of a journal, and those rows as columns.

Runs are checked on the way. Any number of workers may stage; that needs no lock and no order, and staged segments are
not yet part of the ledger. The rows of a journal are made directly from a few events, without columns.
"""

import atexit
import os
import shutil
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.json

from fsar_ledger.base.errors import CommitTooLarge, InvalidRun, LedgerCorrupted, WriteFailed
from fsar_ledger.base.memory import temporary_files, unfinished
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.ledger.log.hashing import HASH_BYTES, sha256_hex
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.blocks import Block, blocks_of
from fsar_ledger.ledger.rows.bounds import MAX_ROWS, MAX_SEGMENT_BYTES, MAX_TEXT_BYTES, has_more_text_than, text_bytes
from fsar_ledger.ledger.rows.check import disordered, unprintable
from fsar_ledger.ledger.rows.codec import encode_coded, encode_hashed, encode_lines
from fsar_ledger.ledger.rows.compiled import MARK_OF, OPENING, Plain, marks_of, plain_lines, plain_rows, plain_table
from fsar_ledger.ledger.rows.layout import read_layout
from fsar_ledger.ledger.rows.runs import LedgerRun, overlong, refusal, require_runs, unreadable
from fsar_ledger.ledger.rows.schema import (
    FINGERPRINT,
    LAYOUTS,
    OPENINGS,
    RELEASE,
    SCHEMA,
    STANDS_ALONE,
    concerns_admitted,
)
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import staged_path


class Staged(msgspec.Struct, frozen=True):
    """The properties of a staged segment that the parent needs to commit it.

    Units: `segment_bytes` bytes, `rows` events. `leaves` are the packed RFC 6962 leaf hashes, 32 bytes per row.
    `blocks` are those of the rows; `goes_on` are the runs that later commits may extend.
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

    Needs no lock and no order. Workers may stage concurrently, but only while a Writer is open: when the only Writer
    opens, it removes uncommitted staged segments. The same runs give the same file.

    Raises:
        CommitTooLarge: They exceed the limits of one commit (see `bounds`). Nothing was written.
        InvalidRun: There are no runs, or one cannot be encoded (see `codec.encode`), has unprintable text (see
            `check.unprintable`), events in the wrong order (see `check.disordered`) or unreadable parameters (see
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
    """Stage encoded runs without checking their names and order, as 0.1.0 did. Raises: As `stage`."""
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


_TAG_OF: dict[type, str] = {layout.cls: tag for tag, layout in LAYOUTS.items()}


def rows_of(runs: Sequence[LedgerRun]) -> tuple[bytes, tuple[Block, ...]]:
    """Return the rows of these runs, the canonical bytes of each followed by a line feed, and their blocks.

    Raises: InvalidRun for whatever `stage` refuses, except its bounds on a segment.
    """
    if not runs:
        raise InvalidRun("found no runs to commit, expected at least 1")
    if len(runs) == 1 and (going_on := _going_on(runs[0])) is not None:
        return going_on
    plain = plain_rows(runs)
    if plain is None or not plain.rows or len(runs) > 1:
        require_runs(runs)
    rows, marks = plain or Plain(b"\n".join((*encode_lines(runs), b"")), tuple(map(marks_of, runs)))
    if (plain is None and not _is_printable(rows)) or not all(map(_is_in_order, runs, marks)):
        table = encode_coded(runs)
        if flaw := unprintable(table):
            raise InvalidRun(f"{flaw}; give it another name")
        if flaw := disordered(table):
            raise refusal(flaw)
    new_runs = [run for run in runs if not run.first]
    if new_runs and (
        flaw := unreadable(new_runs) or overlong(new_runs)
    ):  # the ledger already holds the names of the others
        raise refusal(flaw)
    return rows, tuple(map(_block, runs, marks))


def _going_on(run: LedgerRun) -> tuple[bytes, tuple[Block]] | None:
    """Return the result of `rows_of` for a continued run; None if the fast path does not apply."""
    if not run.first or (lines := plain_lines(run)) is None:
        return None
    rows, marks = lines
    return (rows, (_block(run, marks),)) if rows and _is_in_order(run, marks) else None


def _is_printable(rows: bytes) -> bool:
    """Return whether a quick test shows that all text in these rows, canonical JSON, is printable.

    JSON escapes unprintable ASCII except DEL with a backslash. Testing bytes takes a tenth of the time of testing text.
    """
    text = rows.replace(b"\n", b"")
    return b"\\" not in text and b"\x7f" not in text and (text.isascii() or text.decode().isprintable())


@lru_cache
def _concerns(marks: int) -> tuple[str, ...]:
    return tuple(sorted(concern for concern, mark in MARK_OF.items() if marks & mark))


def _is_in_order(run: LedgerRun, marks: int) -> bool:
    """Return whether a quick test shows that the order of these events and the run's beginning are right."""
    times = run.times_us
    if marks & OPENING or (len(times) > 1 and list(times) != sorted(times)):
        return False
    if run.first:
        return True
    first_tag, observes = _TAG_OF[type(run.events[0])], _observes(run)
    return (
        first_tag in OPENINGS
        and getattr(run.events[0], "records", None) is None
        and (first_tag not in STANDS_ALONE or len(run.events) == 1)
        and (observes is None or (set(observes) <= set(CONCERNS) and set(_concerns(marks)) <= set(observes)))
    )


def _block(run: LedgerRun, marks: int) -> Block:
    return Block(
        run.run_id,
        run.first,
        len(run.events),
        run.times_us[0],
        run.times_us[-1],
        _observes(run),
        _concerns(marks) if run.first else (),
        not run.first and _TAG_OF[type(run.events[0])] in STANDS_ALONE,
        _goes_on_from(run),
    )


def _goes_on_from(run: LedgerRun) -> tuple[str, int] | None:
    """Return the run that this one continues, and its last seq, from event 1; None without such an event."""
    second = run.events[1 - run.first] if run.first <= 1 < run.first + len(run.events) else None
    return (second.continues, second.continues_seq) if isinstance(second, RunContinued) else None


def _observes(run: LedgerRun) -> tuple[str, ...] | None:
    """Return the concerns that the run's events may have, from event 0; None if that is absent or allows all."""
    if run.first or not isinstance(started := run.events[0], RunStarted):
        return None
    return concerns_admitted(started.observes, started.records)


_PARSE = pyarrow.json.ParseOptions(
    explicit_schema=pa.schema([field.with_nullable(True) for field in SCHEMA]),
    unexpected_field_behavior="error",
    newlines_in_values=False,
)
_BLOCK_BYTES = 1 << 24
_folders: list[str] = []  # this process's temporary folder for rows of journals, the last one
_folder_lock = Lock()


def table_of(path: Path, lines: bytes) -> pa.Table:
    """Return these rows of the journal at this path, the canonical bytes of each and a line feed, as a table.

    It has the columns of `SCHEMA` or of `CODED_SCHEMA`.

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
        encoded = canonical.from_table(table.combine_chunks())
    except (pa.ArrowException, ValueError) as error:
        raise LedgerCorrupted(
            f"{path}: found rows that are no events ({error!s:.200}); run fsar-ledger verify, and restore the file"
        ) from error
    for number, (row, line) in enumerate(zip(rows, encoded, strict=True)):
        if line != row:
            raise LedgerCorrupted(
                f"{path}: row {number}: found {row!r:.200}, expected canonical JSON of the columns of events; restore "
                "the file"
            )
    return table.combine_chunks()


class UnstagedSegment(NamedTuple):
    """A segment in memory that is not staged yet: its bytes, and its properties once staged."""

    data: pa.Buffer
    staged: Staged


def made_of(table: pa.Table, leaves: bytes) -> UnstagedSegment:
    """Return a segment of these rows of runs already in a ledger, with these packed leaf hashes."""
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
    """Write these rows as a segment into this process's temporary folder, and return its path. Raises: WriteFailed."""
    data = segment.to_parquet(table)
    with temporary_files(), _folder_lock:  # the file is renamed when complete, so that no reader sees half of it
        if not _folders or not os.path.isdir(_folders[-1]):  # systems remove temporary folders that are some days old
            _folders.append(tempfile.mkdtemp(prefix="fsar-ledger-"))
            atexit.register(shutil.rmtree, _folders[-1], ignore_errors=True)
            unfinished.add(Path(_folders[-1]))
        path = Path(_folders[-1]) / f"{sha256_hex(data)}.parquet"
        if not path.exists():
            part = path.with_suffix(".part")
            part.write_bytes(data)
            part.replace(path)
    return path
