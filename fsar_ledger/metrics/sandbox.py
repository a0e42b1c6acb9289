"""Answer one SELECT in the process that untrusted SQL runs in.

It holds one ledger's events, locks everything else, answers and exits. It starts without the caller's environment.
Before it reads the SQL it permanently gives up what an answer does not need: writing to files, starting processes, the
caller's working folder, and memory, time and open files beyond its limits. DuckDB's own locks apply as well
(`Database.lock`).
"""

import errno
import os
import resource
import signal
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.dataset as ds

from fsar_ledger.base.errors import LedgerCorrupted, QueryFailed
from fsar_ledger.ledger.rows.schema import SCHEMA

from .connection import FAULTS_OF_SQL, OUT_OF_MEMORY, Database
from .own_sql import LISTING, how_to_call, listing, understood
from .relation import hold_dataset

GRACE_S = 5
"""Seconds by which this process's limits exceed the caller's, so that the caller can report what happened."""

FILES = 1024
"""Limit of open files; lower where the system allows fewer.

Arrow reads ahead of DuckDB and opens each segment twice. On a busy machine 51 segments took up to 70, and 400 up to 79.
"""


SENT_BYTES, SLICE_BYTES, VALUE_BYTES = 16 << 20, 1 << 20, 16
"""Bytes sent at once, and bytes converted to Python values at once, so that the caller holds little.

The third is added to the bytes of each value.
"""

ROW_BYTES = 64 << 20
"""Maximum bytes of a row: it cannot be split, and as Python values it may take ten times as much."""

OWN_BYTES = 512 << 20
"""Address space of the process before it answers, with a reserve.

DuckDB gets half of the rest, since growing buffers are copied to twice their size.
"""


class Limits(msgspec.Struct, frozen=True):
    """The limits of an answer.

    Units: seconds of wall clock; bytes of address space, of which an idle process takes 0.4 GiB; rows and bytes of
        the answer; bytes of the SQL.
    """

    seconds: int = 60
    memory_bytes: int = 4 << 30
    rows: int = 1_000_000
    answer_bytes: int = 256 << 20
    sql_bytes: int = 1 << 20


class Question(msgspec.Struct, frozen=True):
    """The request to the process: the SELECT, the ledger's segments in order, and the limits."""

    segments: list[str]
    sql: str
    limits: Limits


class Refusal(msgspec.Struct, frozen=True):
    """Why there is no answer, and whether a damaged segment may be the cause.

    This process has too few resources left to check that.
    """

    message: str
    may_be_damage: bool = False


def answer(descriptor: int) -> None:
    """Read one `Question` from the pipe, and write the parts of the answer as they come, each an Arrow stream.

    After them come an empty message and null, or the `Refusal` that invalidates the parts before it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C also reaches the caller, which ends this process
    with Connection(descriptor) as pipe:
        question = msgspec.json.decode(pipe.recv_bytes(), type=Question)
        give_up(question.limits)
        refusal = None
        try:
            for batch in _select(question):
                for part in slices(batch, SENT_BYTES):
                    pipe.send_bytes(_stream(part))
        except (QueryFailed, LedgerCorrupted, MemoryError, pa.ArrowException, OSError) as error:
            refusal = _refusal(error, question.limits)
        pipe.send_bytes(b"")
        pipe.send_bytes(msgspec.json.encode(refusal))


def _refusal(error: Exception, limits: Limits) -> Refusal:
    """Turn the error into the caller's message."""
    cause = error.__cause__ if isinstance(error, QueryFailed) else error
    if isinstance(cause, (MemoryError, *OUT_OF_MEMORY)):
        return Refusal(f"SQL: ran out of memory, the limit is {limits.memory_bytes >> 20:,} MiB; ask for less")
    if os.strerror(errno.EMFILE) in str(cause):  # DuckDB and Arrow pass on only the text
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        return Refusal(
            f"SQL: needed more than the {limit:,} files it may have open; raise `ulimit -n` if it is below {FILES:,}, "
            "or ask for less at once"
        )
    message = (
        str(error)
        if isinstance(error, (QueryFailed, LedgerCorrupted))
        else f"SQL: {type(error).__name__}: {str(error).partition(chr(10))[0]}"
    )
    return Refusal(message, may_be_damage=cause is not None and not isinstance(cause, FAULTS_OF_SQL))


def give_up(limits: Limits) -> None:
    """Permanently bar this process from writing files, from the working folder, and from exceeding its limits."""
    os.chdir("/")
    allowed = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    limit_of = {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_NOFILE: FILES if allowed == resource.RLIM_INFINITY else min(FILES, allowed),
        resource.RLIMIT_AS: limits.memory_bytes,
    }
    for kind, value in limit_of.items():
        resource.setrlimit(kind, (value, value))
    seconds = limits.seconds + GRACE_S
    # SIGXCPU at the first limit reports why, SIGKILL at the second ends it.
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))


def _checked() -> ds.ParquetFileFormat:
    """Return the Parquet format with verified page checksums: a flipped bit is an error, not an answer."""
    return ds.ParquetFileFormat(
        default_fragment_scan_options=ds.ParquetFragmentScanOptions(page_checksum_verification=True)
    )


def _select(question: Question) -> Iterator[pa.RecordBatch]:
    """Yield the answer, reading no further than its limits; the first batch is empty. Raises: QueryFailed."""
    limits, segments = question.limits, question.segments
    pa.set_cpu_count(1)  # threads reserve address space, which is limited
    pa.set_io_thread_count(1)
    with Database(None, (), threads=1) as database:
        stored = ds.dataset(segments, schema=SCHEMA, format=_checked()) if segments else SCHEMA.empty_table()
        hold_dataset(database, stored, [Path(segment) for segment in segments])
        # See docs/decisions/untrusted-sql-has-its-own-process.md.
        database.lock(limits.seconds + GRACE_S, (limits.memory_bytes - OWN_BYTES) // 2)
        for _ in database.batches("SELECT seq FROM events LIMIT 1"):
            pass  # reading starts its threads; no more can be started below
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
        database.check_one_select(question.sql)
        sql = prepared(database, question.sql)
        database.only_read()
        rows = size = 0
        for batch in map(_plain, _answer_batches(database, sql)):
            rows, size = rows + batch.num_rows, size + batch.nbytes
            if rows > limits.rows:
                raise QueryFailed(f"SQL: found more than {limits.rows:,} rows, the limit; add a LIMIT or aggregate")
            if size > limits.answer_bytes:
                raise QueryFailed(
                    f"SQL: found an answer of more than {limits.answer_bytes:,} bytes, the limit; ask for fewer "
                    "columns or rows"
                )
            for part in slices(batch, ROW_BYTES):
                if (needed := weight(part)) > ROW_BYTES:
                    raise QueryFailed(
                        f"SQL: found a row that takes {needed:,} bytes, expected at most {ROW_BYTES:,}; ask for fewer "
                        "columns or shorter values"
                    )
            yield batch


def prepared(database: Database, sql: str) -> str:
    """Make everything that the SQL reads, and return it in a form that can be run. Raises: QueryFailed."""
    parsed = understood(sql, database.library)
    if parsed.lists:
        database.hold(LISTING, listing())
    for query in parsed.macros:
        database.macro(query)
    database.check_one_select(parsed.sql)
    database.prepare(parsed.sql)
    return parsed.sql


def _answer_batches(database: Database, sql: str) -> Iterator[pa.RecordBatch]:
    """Yield the answer in batches. Raises: As `Database.batches`; QueryFailed also shows how to call a macro."""
    try:
        yield from database.batches(sql)
    except QueryFailed as error:
        raise QueryFailed(f"{error}{how_to_call(str(error), database.library)}") from error.__cause__


def _plain(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Return the batch without dictionaries: each slice would be sent with the whole dictionary."""
    columns = [
        column.dictionary_decode() if pa.types.is_dictionary(column.type) else column for column in batch.columns
    ]
    return pa.RecordBatch.from_arrays(columns, names=batch.schema.names)


def _stream(batch: pa.RecordBatch) -> pa.Buffer:
    """Return the batch as a separate Arrow stream."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    return sink.getvalue()


def slices(batch: pa.RecordBatch, most: int = SLICE_BYTES) -> Iterator[pa.RecordBatch]:
    """Yield the batch in parts of at most `most` bytes as counted by `weight`; a row is never split."""
    if batch.num_rows < 2 or weight(batch) <= most:
        yield batch
        return
    half = batch.num_rows // 2
    yield from slices(batch.slice(0, half), most)
    yield from slices(batch.slice(half), most)


def weight(batch: pa.RecordBatch) -> int:
    """Estimate the bytes that these rows take as Python values, however few Arrow needs."""
    nested = [index for index, kind in enumerate(batch.schema.types) if pa.types.is_nested(kind)]
    flat: int = batch.num_rows * (batch.num_columns - len(nested))
    return int(batch.nbytes) + VALUE_BYTES * (flat + sum(_values(batch.column(index)) for index in nested))


def _values(column: pa.Array) -> int:
    """Count the values of an array, including nested ones."""
    kind = column.type
    if pa.types.is_struct(kind):
        return len(column) + sum(_values(part) for part in column.flatten())
    if pa.types.is_map(kind):
        return len(column) + _values(_entries(column, column.keys)) + _values(_entries(column, column.items))
    return len(column) + (_values(column.flatten()) if pa.types.is_nested(kind) and not pa.types.is_union(kind) else 0)


def _entries(column: pa.Array, entries: pa.Array) -> pa.Array:
    """Return the keys or items that belong to this part of a map."""
    if not len(column):
        return entries.slice(0, 0)
    first, last = column.offsets[0].as_py(), column.offsets[-1].as_py()
    return entries.slice(first, last - first)
