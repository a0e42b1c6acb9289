"""One segment, examined on its own: what a worker of `verify` does."""

import hashlib
import os
import stat
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.arrow import places, whole
from fsar_ledger.ledger.rows.check import first_flaw, run_starts, standing_alone
from fsar_ledger.ledger.rows.layout import Layout, check_layout, read_file, read_layout
from fsar_ledger.ledger.rows.releases import FINGERPRINTS
from fsar_ledger.ledger.rows.schema import SCHEMA, fingerprint
from fsar_ledger.ledger.rows.segment import read_coded, to_parquet
from fsar_ledger.ledger.store.problem import Problem, refusal, unexpected
from fsar_ledger.ledger.store.record import COMMITS, CommitRecord


class SegmentFacts(msgspec.Struct, frozen=True):
    """What a segment holds. `runs` and `leaves` (packed leaf hashes) are None where the rows cannot be trusted to be as written.

    `alone` are those of `runs` that are no runs but one event which stands alone.
    """

    file: str
    problems: tuple[Problem, ...] = ()
    rows: int = 0
    runs: tuple[str, ...] | None = None
    leaves: bytes | None = None
    alone: frozenset[str] = frozenset()


SecondReader = Callable[[str, pa.Table, bool], tuple[str, str] | None]
"""Reads the file at a path with other code than `segment` and compares it with these rows: (found, expected), None if it holds them. True: the file is byte
for byte what these rows are written as."""


def examine(
    file: str, ledger: str, number: int, record: CommitRecord | None, second_reader: SecondReader | None = None
) -> SegmentFacts:
    """What this segment holds, compared with its commit record and with what the second reader finds. Never raises."""
    return _guarded(partial(_examine, second_reader), file, ledger, number, record)


def examine_file(file: str, ledger: str, number: int, record: CommitRecord | None) -> SegmentFacts:
    """Whether this segment is the file that its commit record names, without a look at its rows. Never raises."""
    return _guarded(_examine_file, file, ledger, number, record)


def _guarded(
    check: Callable[[str, str, int, CommitRecord], SegmentFacts],
    file: str,
    ledger: str,
    number: int,
    record: CommitRecord | None,
) -> SegmentFacts:
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


def _examine(
    second_reader: SecondReader | None, file: str, place: str, number: int, record: CommitRecord
) -> SegmentFacts:
    as_a_file = _examine_file(file, place, number, record)
    if (
        as_a_file.problems or record.release not in FINGERPRINTS
    ):  # rows of a release that is not known cannot be judged; the record is a problem already
        return as_a_file
    says = f"as {COMMITS}/{number:012d}.json says"

    def fail(found: object, expected: object, field: str) -> SegmentFacts:
        return SegmentFacts(file, (Problem(file, str(found), str(expected), commit=number, field=field),))

    path = Path(place)
    data = read_file(path)
    if hashlib.sha256(data).hexdigest() != record.segment_sha256:
        return fail("another file than a moment ago", "one file", "segment_sha256")
    try:
        layout = check_layout(path, data)
    except LedgerCorrupted as error:
        return fail(f"no segment {refusal(path, error)}", "one as it is written", "segment_sha256")
    if layout.rows != record.rows:
        return fail(layout.rows, f"{record.rows}, {says}", "rows")
    if fingerprint(layout.schema) != record.schema_sha256:
        return fail(fingerprint(layout.schema), f"{record.schema_sha256}, {says}", "schema_sha256")
    table = read_coded(path, data, layout)
    flaw = first_flaw(table)
    problems = (
        () if flaw is None else (Problem(file, flaw.found, flaw.expected, number, flaw.run, flaw.seq, flaw.field),)
    )
    run_ids = whole(table.column("run_id"))
    runs = tuple(run_ids.take(run_starts(run_ids)).to_pylist())
    stored = table.select(layout.schema.names)
    is_as_written, misleading = _misleading(data, layout, stored)
    again = second_reader(place, stored, is_as_written) if second_reader is not None else None
    problems = (
        *problems,
        *(
            Problem(file, *other, commit=number, field="segment_sha256")
            for other in (misleading, again)
            if other is not None
        ),
    )
    leaves = canonical.leaves(table)
    alone = frozenset(run_ids.filter(pa.array(standing_alone(whole(table.column("type"))))).to_pylist())
    return SegmentFacts(file, problems, table.num_rows, runs, leaves, alone)


def _misleading(data: bytes, layout: Layout, table: pa.Table) -> tuple[bool, tuple[str, str] | None]:
    """Whether the file is what these rows are written as, and what in it beside them (found, expected) could make a reader see others; None if nothing.

    A query engine skips rows by the statistics in the footer, and no leaf covers those. The same version of pyarrow
    must write the same bytes; of a file by another version the statistics are compared.
    """
    is_ours = all(
        _is_sorted(whole(table.column(name))) for name in table.column_names
    )  # else writing them again repeats what is not ours
    again = to_parquet(table)
    if is_ours and again.equals(pa.py_buffer(data)):
        return True, None
    if layout.created_by == pq.read_metadata(pa.BufferReader(again)).created_by:
        return False, ("other bytes", "those that these rows are written as")
    for name, sizes, own in zip(table.column_names, layout.sizes, read_layout(again.to_pybytes()).sizes, strict=True):
        if sizes and own and sizes != own:
            return False, (
                f"sizes of strings and lists {sizes.hex()} in column {name}",
                f"{own.hex()}, as its rows are",
            )
    for said in (*layout.statistics, *layout.of_pages):
        values = table.column(said.name).slice(*said.rows or (0,)).cast(SCHEMA.field(said.name).type)
        least, most = (None if bound is None else _stored(bound) for bound in pc.min_max(values).as_py().values())
        if (said.least, said.most) != (least, most):
            return False, (
                f"statistics {said.least!r} to {said.most!r} of column {said.name}",
                f"{least!r} to {most!r}, as its rows are",
            )
    return False, None


def _stored(value: int | str) -> bytes:
    """A value as the statistics of Parquet hold it."""
    return value.encode() if isinstance(value, str) else value.to_bytes(8, "little", signed=True)


def _is_sorted(column: pa.Array) -> bool:
    """Whether a column is no dictionary, or one as we write it."""
    if not isinstance(column, pa.DictionaryArray):
        return True
    texts = column.dictionary
    if column.null_count == len(column):  # most columns of a segment
        return not len(texts)
    is_used = np.zeros(len(texts) + 1, bool)
    is_used[places(column)] = True
    return bool(is_used[:-1].all()) and pc.all(pc.less(texts[:-1], texts[1:])).as_py() is not False
