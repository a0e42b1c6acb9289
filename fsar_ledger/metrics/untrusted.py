"""Run untrusted SQL in a process that can read one ledger and do nothing else.

A separate process (`sandbox.py`) holds the committed segments as one registered dataset, gives up every other right,
and runs exactly one SELECT or EXPLAIN under limits of memory and processor time; this process kills it at a wall-clock
limit. It answers with Arrow data, never with pickled objects.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from multiprocessing.connection import Pipe
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.segment import first_damage
from fsar_ledger.ledger.store.locations import earlier_runs
from fsar_ledger.ledger.store.record import Head

from .own_sql import SHOWN
from .sandbox import GRACE_S, Limits, Question, Refusal
from .verified import is_verified

ENVIRONMENT = {"ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1"}
"""The whole environment of the process.

Libraries then reserve no address space that they do not use (2.4 GiB become 0.7 GiB).
"""

NEEDED = ("LD_LIBRARY_PATH",)
"""Variables taken from the caller's environment: some interpreters do not start without them."""

START = (
    "import gc, json, os, sys; gc.disable(); sys.path[:] = json.loads(sys.argv[1]); "
    "from fsar_ledger.metrics.sandbox import answer; gc.enable(); answer(int(sys.argv[2])); os._exit(0)"
)
"""Imports create no garbage worth collecting, and the process frees nothing before it exits."""


DYING_S = 5
"""Seconds within which a process ends after its pipe is closed."""

SAID_BYTES = 1 << 16
OUT_OF_MEMORY = ("bad_alloc", "MemoryError", "Cannot allocate memory", "out of memory", "failed to map segment")
"""What C++, Python and the dynamic loader write when an allocation fails."""


class Stream(NamedTuple):
    """The answer of a SELECT at this head, and whether the rows that it read were compared with the head's root.

    `batches` yields some rows at a time. They are an answer only if it ends normally: it raises QueryFailed or
    LedgerCorrupted when a limit, the SQL or a segment prevents the rest.
    """

    head: Head
    rows_verified: bool
    schema: pa.Schema
    batches: Iterator[pa.RecordBatch]

    @property
    def columns(self) -> list[str]:
        """Return the names of the columns."""
        return list(self.schema.names)


@contextmanager
def stream_untrusted(
    ledger: Path, sql: str, limits: Limits | None = None, demanded: str | None = None
) -> Iterator[Stream]:
    """Yield the answer of this SELECT over the ledger's current head; with `demanded`, only over that head.

    The time limit applies until the last batch has been read.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers`; LedgerCorrupted also for a segment
            that is not as committed.
        SequenceConflict: As `is_verified`.
        QueryFailed: The SQL is not one SELECT, does not run, accesses something outside, or exceeds a limit.
    """
    limits = limits or Limits()
    check_text(sql, limits)
    with closing(_Process(limits)) as process:  # it starts while the ledger is opened
        view = open_for_answers(ledger)
        rows_verified = is_verified(view, demanded)
        earlier_runs(view)
        segments = view.segments()
        process.send(msgspec.json.encode(Question([str(path.resolve()) for path in segments], sql, limits)))
        parts = _parts(process, segments)
        yield Stream(view.head, rows_verified, next(parts).schema, parts)


def table_untrusted(ledger: Path, sql: str, limits: Limits | None, demanded: str | None) -> tuple[pa.Table, Head, bool]:
    """Return the answer of this SELECT in Arrow, its head, and whether the rows it read were compared with the root.

    Raises: as `stream_untrusted`.
    """
    with stream_untrusted(ledger, sql, limits, demanded) as stream:
        return pa.Table.from_batches(stream.batches, stream.schema), stream.head, stream.rows_verified


def _parts(process: "_Process", segments: Sequence[Path]) -> Iterator[pa.RecordBatch]:
    """Yield the parts of the answer, the first without rows. Raises: LedgerCorrupted, QueryFailed: it is incomplete."""
    while data := process.receive():
        yield from pa.ipc.open_stream(data)
        process.check_time()
    refusal = msgspec.json.decode(process.receive(), type=Refusal | None)
    if refusal is not None:
        raise (first_damage(segments) if refusal.may_be_damage else None) or QueryFailed(refusal.message)


def check_text(sql: str, limits: Limits) -> None:
    """Check that the SQL is text that DuckDB accepts.

    Raises:
        QueryFailed: It is too long, is not Unicode, or holds a NUL character.
    """
    try:
        size = len(sql.encode())
    except UnicodeEncodeError as error:
        raise QueryFailed(
            f"SQL: found bytes that are not UTF-8 at character {error.start + 1}, expected text; save it as UTF-8"
        ) from error
    if size > limits.sql_bytes:
        raise QueryFailed(
            f"SQL: found {size:,} bytes of text, expected at most {limits.sql_bytes:,}; split the question"
        )
    if "\0" in sql:
        raise QueryFailed(f"SQL: found a NUL at character {sql.index(chr(0)) + 1}, expected text; remove it")


class _Process:
    """A process that waits for a `Question`, and the pipe to it.

    It is killed when its time is up, whatever either side is doing.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.pipe, child_pipe = Pipe()
        self._said, stderr = os.pipe()
        os.set_blocking(stderr, False)  # what does not fit into the pipe is dropped instead of blocking
        os.set_blocking(self._said, False)
        paths = json.dumps([os.path.abspath(path) for path in sys.path])
        try:
            self._child = subprocess.Popen(
                [sys.executable, "-I", "-B", "-X", "utf8", "-c", START, paths, str(child_pipe.fileno())],
                env=ENVIRONMENT | {name: os.environ[name] for name in NEEDED if name in os.environ},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                pass_fds=[child_pipe.fileno()],
            )
        finally:
            child_pipe.close()
            os.close(stderr)
        self._ends = time.monotonic() + limits.seconds
        self._alarm = threading.Timer(limits.seconds, self._child.kill)
        self._alarm.daemon = True
        self._alarm.start()

    def send(self, data: bytes) -> None:
        """Send these bytes to the process. Raises: QueryFailed if it has ended."""
        try:
            self.pipe.send_bytes(data)
        except OSError as error:
            raise self._query_failure() from error

    def receive(self) -> bytes:
        """Return the next message of the process. Raises: QueryFailed if it has ended, or its time is up."""
        try:
            return self.pipe.recv_bytes(self.limits.answer_bytes)
        except (EOFError, OSError) as error:
            raise self._query_failure() from error

    def check_time(self) -> None:
        """Raises: QueryFailed if the time is up."""
        if time.monotonic() >= self._ends:
            raise self._query_failure()

    def close(self) -> None:
        """End the process and close the pipes to it."""
        self._alarm.cancel()
        self._child.kill()
        self._child.wait()
        self.pipe.close()
        os.close(self._said)

    def _query_failure(self) -> QueryFailed:
        if time.monotonic() >= self._ends:
            return QueryFailed(
                f"SQL: found no answer after {self.limits.seconds} s, the limit; ask for less, or use a packaged query"
            )
        try:
            code: int | None = self._child.wait(DYING_S)
        except subprocess.TimeoutExpired:
            code = None
        try:
            output = os.read(self._said, SAID_BYTES).decode(errors="replace")
        except OSError:
            output = ""
        return QueryFailed(f"SQL: the process that ran it {cause_of_death(code, output, self.limits)}")


def cause_of_death(code: int | None, said: str, limits: Limits) -> str:
    """Return why a process ended without an answer, and what to do.

    It is derived from the exit code (negative: a signal's number) and the end of what the process wrote to stderr.
    """
    last = next((line for line in reversed(said.splitlines()) if line.strip()), "nothing")[:SHOWN]
    memory = (
        f"ran out of memory, the limit is {limits.memory_bytes >> 20:,} MiB; ask for less, or raise it with --memory"
    )
    if any(sign in said for sign in OUT_OF_MEMORY):
        return memory
    if code is None:
        return "closed its pipe and did not end; please report this"
    if code >= 0:
        return f"ended with exit code {code}, as when it cannot start; its last output: {last}"
    killer = next((known for known in signal.Signals if known == -code), None)
    if killer == signal.SIGXCPU:
        return f"used {limits.seconds + GRACE_S} s of processor time, and its limit is {limits.seconds} s; ask for less"
    if killer == signal.SIGKILL:
        return "was killed from outside (SIGKILL), perhaps because memory is short; free some memory and ask again"
    if killer in (signal.SIGSEGV, signal.SIGBUS):
        return (
            f"crashed ({signal.Signals(-code).name}): values are nested too deeply, or DuckDB has a bug there; ask for "
            "it in another way"
        )
    return f"was ended by {f'signal {-code}' if killer is None else killer.name}; its last output: {last}"
