"""Examine one segment on its own: the task of a worker of `verify`."""

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.base.workers import pool_of
from fsar_ledger.ledger.rows import Columns, canonical
from fsar_ledger.ledger.rows.blocks import Block, blocks_of
from fsar_ledger.ledger.rows.check import first_flaw
from fsar_ledger.ledger.rows.layout import Layout, check_layout, read_layout
from fsar_ledger.ledger.rows.schema import FINGERPRINTS, SCHEMA, fingerprint
from fsar_ledger.ledger.rows.segment import read_coded, to_parquet
from fsar_ledger.ledger.store.problem import Problem, refusal, unexpected
from fsar_ledger.ledger.store.segments import Names, Stored, find_segment, read_segment

_MOST_SEGMENTS, _MOST_ROWS = 16, 1 << 18
"""How many segments and rows a second reader reads at once: planning takes longer than reading one segment."""


class Digest(NamedTuple):
    """The columns of some rows, and numbers computed from their values."""

    columns: tuple[str, ...]
    numbers: tuple[int, ...]


class SegmentFacts(msgspec.Struct, frozen=True):
    """The content of a segment. `leaves` (packed leaf hashes) are None if the rows are in doubt.

    `blocks` are those of a segment without a flaw. `digest` is that of the rows if writing them gives the same file,
    which a second reader has not read yet.
    """

    file: str
    problems: tuple[Problem, ...] = ()
    rows: int = 0
    leaves: bytes | None = None
    blocks: tuple[Block, ...] = ()
    digest: Digest | None = None


_Asked: TypeAlias = tuple[int, Stored, Names]
"""The number of a segment, its record and its names."""


class SecondReader(Protocol):
    """A reader of files with code other than `segment`, which compares them with the rows that `segment` decoded.

    Differences are (found, expected). It can be pickled.
    """

    def by_value(self, path: str, decoded: pa.Table) -> tuple[str, str] | None:
        """Return the difference of the file at this path, compared value by value; None if it holds these rows."""

    def digest(self, decoded: pa.Table) -> Digest:
        """Return the digest of these rows, for `by_digest`."""

    def by_digest(self, digests: Mapping[str, Digest]) -> Mapping[str, tuple[str, str]]:
        """Return the differences, by path; writing the rows gives the same files, to the byte."""


def examine(
    ledger: str,
    number: int,
    record: Stored,
    names: Names,
    second_reader: SecondReader | None = None,
) -> SegmentFacts:
    """Compare the segment with these names with its record and with the rows that the second reader finds.

    Comparison by digest is left to `examine_some`. The segment's runs may begin or end in other segments.

    Raises: Only as `unexpected`.
    """
    return _guarded(partial(_examine, second_reader), Path(ledger), number, record, names)


def examine_some(
    one: Callable[..., SegmentFacts],
    ledger: str,
    segments: Sequence[_Asked],
    second_reader: SecondReader | None,
) -> list[SegmentFacts]:
    """Return the facts of each of these segments by `one`, which is `examine`; digests are compared together."""
    examined = [one(ledger, number, record, names, second_reader) for number, record, names in segments]
    digests = {f"{ledger}/{facts.file}": facts.digest for facts in examined if facts.digest is not None}
    differences = second_reader.by_digest(digests) if second_reader is not None and digests else {}
    for index, (facts, (number, _, _)) in enumerate(zip(examined, segments, strict=True)):
        if (difference := differences.get(f"{ledger}/{facts.file}")) is not None:
            problem = Problem(facts.file, *difference, commit=number, field="segment_sha256")
            examined[index] = msgspec.structs.replace(facts, problems=(*facts.problems, problem))
    return examined


def examine_file(ledger: str, number: int, record: Stored, names: Names) -> SegmentFacts:
    """Compare the file of the segment with these names with its record, without reading the rows.

    Raises: Only as `unexpected`.
    """
    return _guarded(_examine_file, Path(ledger), number, record, names)


# See docs/decisions/verify-rereads-every-byte.md.
def examine_all(
    ledger: Path,
    segments: Sequence[_Asked],
    workers: int,
    second_reader: SecondReader | None,
    *,
    is_quick: bool,
) -> Iterator[SegmentFacts]:
    """Yield the facts of each segment, in order, as `examine` or, if `is_quick`, as `examine_file`.

    Args:
        ledger: Its folder.
        segments: Number, record and names of each.
        workers: Processes, or threads if `is_quick`: hashing releases the interpreter lock.
        second_reader: As in `examine`.
        is_quick: Read no rows.
    """
    if not segments:
        return
    workers = min(workers, len(segments))
    with ExitStack() as stack:
        if is_quick:
            each = stack.enter_context(ThreadPoolExecutor(workers)).map if workers > 1 else map
            yield from each(examine_file, repeat(str(ledger)), *zip(*segments, strict=True))
            return
        arguments = (repeat(examine), repeat(str(ledger)), _together(segments, workers), repeat(second_reader))
        pool = stack.enter_context(pool_of(workers))
        for part in (pool.map if pool else map)(examine_some, *arguments):
            yield from part


def _together(segments: Sequence[_Asked], workers: int) -> Iterator[list[_Asked]]:
    """Yield these segments in parts that are read at once, at least about four for each of several workers."""
    most = _MOST_SEGMENTS if workers == 1 else max(1, min(_MOST_SEGMENTS, len(segments) // (4 * workers)))
    part: list[_Asked] = []
    rows = 0
    for number, record, names in segments:
        rows += record.rows
        if part and (len(part) == most or rows > _MOST_ROWS):
            yield part
            part, rows = [], record.rows
        part.append((number, record, names))
    if part:
        yield part


_Check = Callable[[Path, str, int, Stored, Names], SegmentFacts]


def _guarded(check: _Check, ledger: Path, number: int, record: Stored, names: Names) -> SegmentFacts:
    try:
        return _checked(check, ledger, number, record, names)
    except FileNotFoundError:  # its writer moved it into place meanwhile
        try:
            return _checked(check, ledger, number, record, names)
        except FileNotFoundError as error:
            return SegmentFacts(names.place, (unexpected(names.place, number, error),))


def _checked(check: _Check, ledger: Path, number: int, record: Stored, names: Names) -> SegmentFacts:
    """Check the segment where it is found.

    Raises:
        FileNotFoundError: It was found, but was gone when it was read.
    """
    segment = find_segment(ledger, number, record, names)
    if segment.problem is not None:
        return SegmentFacts(segment.file, (segment.problem,))
    try:
        return check(ledger, segment.file, number, record, names)
    except FileNotFoundError:
        raise
    except (Exception, RecursionError) as error:
        return SegmentFacts(segment.file, (unexpected(segment.file, number, error),))


def _examine_file(ledger: Path, file: str, number: int, record: Stored, names: Names) -> SegmentFacts:
    _, problem = read_segment(ledger, file, number, record, names, is_kept=False)
    return SegmentFacts(file, (problem,)) if problem is not None else SegmentFacts(file, rows=record.rows)


def _examine(
    second_reader: SecondReader | None, ledger: Path, file: str, number: int, record: Stored, names: Names
) -> SegmentFacts:
    data, problem = read_segment(ledger, file, number, record, names)
    if problem is not None:
        return SegmentFacts(file, (problem,))
    if record.release not in FINGERPRINTS:  # its rows cannot be judged; the record is a problem already
        return SegmentFacts(file, rows=record.rows)
    source = f"as {names.said_by} says"

    def fail(found: object, expected: object, field: str) -> SegmentFacts:
        return SegmentFacts(file, (Problem(file, str(found), str(expected), commit=number, field=field),))

    path = ledger / file
    try:
        layout = check_layout(path, data)
    except LedgerCorrupted as error:
        return fail(f"no segment {refusal(path, error)}", "one as it is written", "segment_sha256")
    if layout.rows != record.rows:
        return fail(layout.rows, f"{record.rows}, {source}", "rows")
    if fingerprint(layout.schema) != record.schema_sha256:
        return fail(fingerprint(layout.schema), f"{record.schema_sha256}, {source}", "schema_sha256")
    table = read_coded(path, data, layout)
    columns = Columns(table)
    flaw = first_flaw(columns, is_whole=False)
    problems = (
        () if flaw is None else (Problem(file, flaw.found, flaw.expected, number, flaw.run, flaw.seq, flaw.field),)
    )
    stored = table.select(layout.schema.names)
    is_as_written, misleading = _misleading(data, layout, stored, columns)
    difference = second_reader.by_value(str(path), stored) if second_reader is not None and not is_as_written else None
    digest = second_reader.digest(stored) if second_reader is not None and is_as_written else None
    problems = (
        *problems,
        *(
            Problem(file, *other, commit=number, field="segment_sha256")
            for other in (misleading, difference)
            if other is not None
        ),
    )
    leaves = canonical.leaves(columns)
    blocks = tuple(blocks_of(table)) if flaw is None else ()
    return SegmentFacts(file, problems, table.num_rows, leaves, blocks, digest)


def _misleading(data: bytes, layout: Layout, table: pa.Table, columns: Columns) -> tuple[bool, tuple[str, str] | None]:
    """Return whether writing these rows gives the same file, and any part that could make a reader see other rows.

    That is (found, expected), or None. A query engine skips rows by the statistics in the footer, which no leaf covers.
    The same version of pyarrow must write the same bytes; for a file by another version, the statistics are compared.
    """
    # Otherwise rewriting the rows would reproduce a dictionary that our writer does not make.
    is_ours = all(_is_sorted(name, columns) for name in table.column_names)
    rewritten = to_parquet(table)
    if is_ours and rewritten.equals(pa.py_buffer(data)):
        return True, None
    if layout.created_by == pq.read_metadata(pa.BufferReader(rewritten)).created_by:
        return False, ("other bytes", "those that these rows are written as")
    for name, sizes, rewritten_sizes in zip(
        table.column_names, layout.sizes, read_layout(rewritten.to_pybytes()).sizes, strict=True
    ):
        if sizes and rewritten_sizes and sizes != rewritten_sizes:
            return False, (
                f"sizes of strings and lists {sizes.hex()} in column {name}",
                f"{rewritten_sizes.hex()}, as its rows are",
            )
    for info in (*layout.statistics, *layout.of_pages):
        values = table.column(info.name).slice(*info.rows or (0,)).cast(SCHEMA.field(info.name).type)
        least, most = (None if bound is None else _stored(bound) for bound in pc.min_max(values).as_py().values())
        if (info.least, info.most) != (least, most):
            return False, (
                f"statistics {info.least!r} to {info.most!r} of column {info.name}",
                f"{least!r} to {most!r}, as its rows are",
            )
    return False, None


def _stored(value: int | str) -> bytes:
    """Return a value as stored in Parquet statistics."""
    return value.encode() if isinstance(value, str) else value.to_bytes(8, "little", signed=True)


def _is_sorted(name: str, columns: Columns) -> bool:
    """Return whether a column has no dictionary, or one in our writer's form."""
    if not isinstance(columns.arrays[name], pa.DictionaryArray):
        return True
    texts = columns.texts[name]
    if columns.arrays[name].null_count == len(columns.table):  # true of most columns of a segment
        return not texts
    is_used = np.zeros(len(texts) + 1, bool)
    is_used[columns.places[name]] = True
    return bool(is_used[:-1].all()) and all(map(operator.lt, texts, texts[1:]))
