"""SQL that anyone may have written, run where it can read one ledger and do nothing else.

A process of its own (`locked.py`) holds the committed segments as one registered dataset, gives up every other right,
and runs exactly one SELECT or EXPLAIN under limits of memory and processor time; this side kills it at a wall-clock
limit. What comes back is Arrow data, never pickled objects.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.errors import QueryFailed
from fsar_ledger.ledger.layout import check_bounds
from fsar_ledger.ledger.read import Head, open_ledger

from .database import first_damage, plain_rows
from .locked import Limits, Question, Refusal

ENVIRONMENT = {"ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1"}
"""All that the process finds in its environment: libraries then reserve no address space that they do not use (2.4 GiB become 0.7 GiB)."""

NEEDED = ("LD_LIBRARY_PATH",)
"""What it is given of the caller's environment: some interpreters do not start without it."""

START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from fsar_ledger.metrics.locked import answer; answer(int(sys.argv[2]))"


class Answer(msgspec.Struct, frozen=True):
    """The rows that a SELECT yielded at this head."""

    head: Head
    columns: list[str]
    rows: list[dict[str, Any]]


def run_untrusted(ledger: Path, sql: str, limits: Limits | None = None) -> Answer:
    """The answer of this SELECT over the ledger's present head.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for a segment that cannot be read.
        QueryFailed: The SQL is not one SELECT, does not run, reaches for something outside, or meets a limit.
    """
    limits = limits or Limits()
    check_text(sql, limits)
    view = open_ledger(ledger)
    segments = [str(path.resolve()) for path in view.segments() if check_bounds(path)]
    with _process() as pipe:
        try:
            pipe.send_bytes(msgspec.json.encode(Question(segments, sql, limits)))
            if not pipe.poll(limits.seconds):
                raise QueryFailed(f"SQL: found no answer after {limits.seconds} s, the limit; ask for less, or use a packaged query")
            refusal = msgspec.json.decode(pipe.recv_bytes(), type=Refusal | None)
            if refusal is not None:
                raise (first_damage(view.segments()) if refusal.may_be_damage else None) or QueryFailed(refusal.message)
            table = pa.ipc.open_stream(pipe.recv_bytes(limits.answer_bytes)).read_all()
        except (EOFError, OSError) as error:
            raise QueryFailed(
                f"SQL: the process that ran it broke off without an answer: it met the limit of memory ({limits.memory_bytes >> 20:,} MiB) "
                f"or of processor time ({limits.seconds} s), or values nest too deep; ask for less"
            ) from error
    try:
        return Answer(view.head, table.column_names, plain_rows(table))
    except (OverflowError, ValueError) as error:
        raise QueryFailed(
            "SQL: found a date or time that an answer cannot show, expected years 1 to 9999 and whole microseconds; make it text, as in CAST(... AS VARCHAR)"
        ) from error


def check_text(sql: str, limits: Limits) -> None:
    """The SQL is text that DuckDB can be given.

    Raises:
        QueryFailed: It is too long, is not Unicode, or holds a NUL character.
    """
    try:
        size = len(sql.encode())
    except UnicodeEncodeError as error:
        raise QueryFailed(f"SQL: found bytes that are not UTF-8 at character {error.start + 1}, expected text; save it as UTF-8") from error
    if size > limits.sql_bytes:
        raise QueryFailed(f"SQL: found {size:,} bytes of text, expected at most {limits.sql_bytes:,}; split the question")
    if "\0" in sql:
        raise QueryFailed(f"SQL: found a NUL at character {sql.index(chr(0)) + 1}, expected text; remove it")


@contextmanager
def _process() -> Iterator[Connection]:
    """The pipe to a process that waits for a `Question`; the process is gone at the end, however that comes."""
    here, there = Pipe()
    path = json.dumps([os.path.abspath(place) for place in sys.path])
    child = subprocess.Popen(
        [sys.executable, "-I", "-B", "-X", "utf8", "-c", START, path, str(there.fileno())],
        env=ENVIRONMENT | {name: os.environ[name] for name in NEEDED if name in os.environ},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,  # a library that dies of the memory limit writes there; this side says what happened
        pass_fds=[there.fileno()],
    )
    try:
        there.close()
        yield here
    finally:
        child.kill()
        child.wait()
        here.close()
