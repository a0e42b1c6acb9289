"""SQL that anyone may have written, run where it can read one ledger and do nothing else.

A spawned process holds the committed segments as one registered dataset, then locks DuckDB down and runs exactly one
SELECT or EXPLAIN under limits of memory and processor time; the parent kills it at a wall-clock limit. What comes back
is Arrow data, never pickled objects.
"""

import os
import resource
import signal
from collections.abc import Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.dataset as ds

from fsar_ledger.errors import FsarLedgerError, LedgerCorrupted, QueryFailed
from fsar_ledger.ledger.read import Head, open_ledger
from fsar_ledger.ledger.schema import SCHEMA

from .database import Database, plain_rows

GRACE_S = 5
"""Seconds by which the limits inside the child come later than the parent's, so that it is the parent who says what happened."""


class Limits(msgspec.Struct, frozen=True):
    """What an answer may cost. Units: seconds of wall clock; bytes of address space; rows and bytes of the answer."""

    seconds: int = 60
    memory_bytes: int = 4 << 30
    rows: int = 1_000_000
    answer_bytes: int = 256 << 20


class Answer(msgspec.Struct, frozen=True):
    """The rows that a SELECT yielded at this head."""

    head: Head
    columns: list[str]
    rows: list[dict[str, Any]]


class _Refusal(msgspec.Struct, frozen=True):
    """Why there is no answer, as the child says it."""

    kind: str
    message: str


_ERRORS: Mapping[str, type[FsarLedgerError]] = {"LedgerCorrupted": LedgerCorrupted, "QueryFailed": QueryFailed}


def run_untrusted(ledger: Path, sql: str, limits: Limits | None = None) -> Answer:
    """The answer of this SELECT over the ledger's present head.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for a segment that cannot be read.
        QueryFailed: The SQL is not one SELECT, does not run, reaches for something outside, or meets a limit.
    """
    limits = limits or Limits()
    view = open_ledger(ledger)
    spawn = get_context("spawn")
    here, there = spawn.Pipe(duplex=False)
    child = spawn.Process(target=_child, args=(there, [str(path) for path in view.segments()], sql, limits), daemon=True)
    child.start()
    there.close()
    try:
        if not here.poll(limits.seconds):
            raise QueryFailed(f"SQL: found no answer after {limits.seconds} s, the limit; ask for less, or use a packaged query")
        refusal = msgspec.json.decode(here.recv_bytes(), type=_Refusal | None)
        if refusal is not None:
            raise _ERRORS.get(refusal.kind, QueryFailed)(refusal.message)
        table = pa.ipc.open_stream(here.recv_bytes(limits.answer_bytes)).read_all()
    except (EOFError, OSError) as error:
        child.join(1)
        raise QueryFailed(
            f"SQL: the process that ran it ended without an answer (exit code {child.exitcode}): it met the limit of memory "
            f"({limits.memory_bytes >> 20} MiB), processor time or size ({limits.answer_bytes >> 20} MiB); ask for less"
        ) from error
    finally:
        child.kill()
        child.join()
        here.close()
    return Answer(view.head, table.column_names, plain_rows(table))


def _child(pipe: Connection, segments: list[str], sql: str, limits: Limits) -> None:
    """The answer, or why there is none, is in the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which ends this process
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 2)  # a library that dies of the memory limit writes to stderr; the parent says what happened
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (limits.seconds + GRACE_S, limits.seconds + GRACE_S))
    try:
        table = _select(segments, sql, limits)
    except FsarLedgerError as error:
        refusal = _Refusal(type(error).__name__, str(error))
    except (MemoryError, pa.ArrowException, OSError) as error:
        refusal = _Refusal("QueryFailed", f"SQL: {type(error).__name__}: {str(error).partition(chr(10))[0]}")
    else:
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, table.schema) as writer:
            writer.write_table(table)
        pipe.send_bytes(b"null")
        pipe.send_bytes(sink.getvalue())
        return
    pipe.send_bytes(msgspec.json.encode(refusal))


def _checked() -> ds.ParquetFileFormat:
    """Parquet whose page checksums are verified: a flipped bit is an error and not an answer."""
    return ds.ParquetFileFormat(default_fragment_scan_options=ds.ParquetFragmentScanOptions(page_checksum_verification=True))


def _select(segments: list[str], sql: str, limits: Limits) -> pa.Table:
    """The answer, read no further than the limit of rows. Raises: QueryFailed, LedgerCorrupted."""
    pa.set_cpu_count(1)  # threads reserve address space, which is limited
    pa.set_io_thread_count(1)
    with Database(None, [Path(segment) for segment in segments], threads=1) as database:
        database.hold("events", ds.dataset(segments, schema=SCHEMA, format=_checked()) if segments else SCHEMA.empty_table())
        database.check_one_select(sql)
        database.prepare(sql)
        database.lock(limits.seconds + GRACE_S)
        batches: list[pa.RecordBatch] = []
        rows = 0
        for batch in database.batches(sql):
            rows += batch.num_rows
            if rows > limits.rows:
                raise QueryFailed(f"SQL: found more than {limits.rows:,} rows, the limit; add a LIMIT or aggregate")
            batches.append(batch)
        return pa.Table.from_batches(batches)
