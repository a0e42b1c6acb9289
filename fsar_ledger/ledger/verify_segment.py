"""One segment, examined on its own: what a worker of `verify` does."""

import hashlib
import os
import stat
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger import canonical
from fsar_ledger.ledger.arrow import places, whole
from fsar_ledger.ledger.bounds import Footer, check_bounds
from fsar_ledger.ledger.check import first_flaw, run_starts
from fsar_ledger.ledger.problem import Problem, refusal, unexpected
from fsar_ledger.ledger.record import COMMITS, CommitRecord
from fsar_ledger.ledger.releases import FINGERPRINTS
from fsar_ledger.ledger.schema import SCHEMA, fingerprint
from fsar_ledger.ledger.segment import read_coded, to_parquet


class SegmentFacts(msgspec.Struct, frozen=True):
    """What a segment holds. `runs` and `leaves` (packed leaf hashes) are None where the rows cannot be trusted to be as written."""

    file: str
    problems: tuple[Problem, ...] = ()
    rows: int = 0
    runs: tuple[str, ...] | None = None
    leaves: bytes | None = None


def examine(file: str, ledger: str, number: int, record: CommitRecord | None) -> SegmentFacts:
    """What this segment holds, compared with its commit record. Never raises."""
    return _guarded(_examine, file, ledger, number, record)


def examine_file(file: str, ledger: str, number: int, record: CommitRecord | None) -> SegmentFacts:
    """Whether this segment is the file that its commit record names, without a look at its rows. Never raises."""
    return _guarded(_examine_file, file, ledger, number, record)


def _guarded(check: Callable[[str, str, int, CommitRecord], SegmentFacts], file: str, ledger: str, number: int, record: CommitRecord | None) -> SegmentFacts:
    if record is None:
        return SegmentFacts(file)
    try:
        return check(file, f"{ledger}/{file}", number, record)
    except (Exception, RecursionError) as error:
        return SegmentFacts(file, (unexpected(file, number, error),))


def _examine_file(file: str, path: str, number: int, record: CommitRecord) -> SegmentFacts:
    says = f"as {COMMITS}/{number:012d}.json says"

    def fail(found: object, expected: str, field: str) -> SegmentFacts:
        return SegmentFacts(file, (Problem(file, str(found), f"{expected}, {says}", commit=number, field=field),))

    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError as error:
        return fail(error.strerror, f"a segment of {record.rows} events", "segment_sha256")
    with open(handle, "rb") as opened:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            return fail("no regular file", f"a segment of {record.rows} events", "segment_sha256")
        if status.st_size != record.segment_bytes:
            return fail(status.st_size, f"{record.segment_bytes}", "segment_bytes")
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
    if digest != record.segment_sha256:
        return fail(digest, record.segment_sha256, "segment_sha256")
    return SegmentFacts(file, rows=record.rows)


def _examine(file: str, place: str, number: int, record: CommitRecord) -> SegmentFacts:
    as_a_file = _examine_file(file, place, number, record)
    if as_a_file.problems or record.release not in FINGERPRINTS:  # rows of a release that is not known cannot be judged; the record is a problem already
        return as_a_file
    says = f"as {COMMITS}/{number:012d}.json says"

    def fail(found: object, expected: object, field: str) -> SegmentFacts:
        return SegmentFacts(file, (Problem(file, str(found), str(expected), commit=number, field=field),))

    path = Path(place)
    try:
        footer = check_bounds(path)
    except LedgerCorrupted as error:
        return fail(f"no segment {refusal(path, error)}", "one as it is written", "segment_sha256")
    metadata = footer.metadata
    if metadata.num_rows != record.rows:
        return fail(metadata.num_rows, f"{record.rows}, {says}", "rows")
    table = read_coded(path, footer)
    columns = metadata.schema.to_arrow_schema()
    if fingerprint(columns) != record.schema_sha256:
        return fail(fingerprint(columns), f"{record.schema_sha256}, {says}", "schema_sha256")
    flaw = first_flaw(table)
    problems = () if flaw is None else (Problem(file, flaw.found, flaw.expected, number, flaw.run, flaw.seq, flaw.field),)
    run_ids = whole(table.column("run_id"))
    runs = tuple(run_ids.take(run_starts(run_ids)).to_pylist())
    misleading = _misleading(path, footer, table.select(columns.names))
    if misleading is not None:
        problems = (*problems, Problem(file, *misleading, commit=number, field="segment_sha256"))
    leaves = b"".join(canonical.hashes(canonical.from_table(table)))
    return SegmentFacts(file, problems, table.num_rows, runs, leaves)


def _misleading(path: Path, footer: Footer, table: pa.Table) -> tuple[str, str] | None:
    """What in the file beside its rows (found, expected) could make a reader see other rows than those; None if nothing.

    A query engine skips rows by the statistics in the footer, and no leaf covers those. The same version of pyarrow
    must write the same bytes; of a file by another version the statistics are compared.
    """
    is_ours = all(_is_sorted(whole(table.column(name))) for name in table.column_names)  # else writing them again repeats what is not ours
    again = to_parquet(table)
    if is_ours and again.equals(pa.py_buffer(path.read_bytes())):
        return None
    if footer.metadata.created_by == pq.read_metadata(pa.BufferReader(again)).created_by:
        return "other bytes", "those that these rows are written as"
    if footer.has_order:
        return "a declared order of rows", "none: readers skip rows by it, and nothing vouches for it"
    for column in footer.columns:
        if column.has_index:
            return f"an index or a Bloom filter of column {column.path}", "none: readers skip rows by them, and nothing vouches for what they say"
        values = table.column(column.path).cast(SCHEMA.field(column.path).type) if column.path in table.column_names else None
        nulls = values.null_count if values is not None else None
        least, most = map(_stored, pc.min_max(values).as_py().values()) if values is not None else (None, None)
        if {*column.least} - {least} or {*column.most} - {most} or column.nulls not in (None, nulls):
            said = f"{[*column.least]} to {[*column.most]} and {column.nulls} NULL"
            return f"statistics {said} of column {column.path}", f"{least!r} to {most!r} and {nulls} NULL, as its rows are"
    return None


def _stored(value: bool | int | str | None) -> bytes | None:
    """A value as the statistics of Parquet hold it."""
    if isinstance(value, str):
        return value.encode()
    return None if value is None else value.to_bytes(1 if isinstance(value, bool) else 8, "little", signed=not isinstance(value, bool))


def _is_sorted(column: pa.Array) -> bool:
    """Whether a column is no dictionary, or one as we write it."""
    if not isinstance(column, pa.DictionaryArray):
        return True
    texts = column.dictionary.to_pylist()
    is_used = np.zeros(len(texts) + 1, bool)
    is_used[places(column)] = True
    return bool(is_used[:-1].all()) and all(one < other for one, other in pairwise(texts))
