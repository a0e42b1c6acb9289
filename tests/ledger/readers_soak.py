"""Mutate the structure of segments, and demand that each is refused or read alike: `python -m tests.ledger.readers_soak
[N] [--loose]` (100,000).

What `check_layout` accepts is read by pyarrow, DuckDB and Polars in a process of its own, which a reader may crash.
Exits with 1 if two of them read different values, or one cannot read what another reads; a file that none can read
(`unread`) misleads nobody. With `--loose` nothing is checked: then there must be such files, or this soak is worth
nothing.
"""

import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.ledger.rows import layout, segment
from fsar_ledger.ledger.rows.codec import encode
from tests.ledger.mutations import KINDS, Template, mutated
from tests.ledger.samples import made_up_run, run_of_every_type

OUTCOMES = ("refused", "alike", "unread", "different")
UNREAD = "no reader reads it"
WORKERS = 2
BATCH = 500


def segments() -> list[bytes]:
    """Return small segments of several shapes."""
    tables = [
        encode([run_of_every_type("every", seed=5)]),
        encode([made_up_run("one", 3, 1)]),
        encode([made_up_run("a", 30, 2), made_up_run("b", 25, 3)]),
    ]
    return [bytes(segment.to_parquet(table)) for table in tables]


def is_accepted(data: bytes) -> bool:
    """Return whether the package would read this segment at all."""
    try:
        layout.read_layout(data)
    except ValueError:
        return False
    return True


def read_by_all(data: bytes, place: Path) -> dict[str, Any]:
    """Return what each reader finds: a table, or the name of the exception."""
    import duckdb
    import polars as pl

    place.write_bytes(data)
    readers: dict[str, Callable[[], pa.Table]] = {
        "pyarrow": lambda: pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True).read(
            use_threads=False
        ),
        "DuckDB": lambda: duckdb.connect().sql(f"SELECT * FROM read_parquet('{place}')").to_arrow_table(),
        "Polars": lambda: pl.read_parquet(place, use_statistics=False, glob=False).to_arrow(),
    }
    found: dict[str, Any] = {}
    for name, read in readers.items():
        try:
            found[name] = read()
        except BaseException as error:  # Polars panics with one that is not an Exception
            found[name] = f"{type(error).__name__}: {error}"[:200]
    return found


def difference(data: bytes, place: Path) -> str | None:
    """Return how the readers differ; None if they read alike, `UNREAD` if none of them reads anything."""
    found = read_by_all(data, place)
    tables = {name: table for name, table in found.items() if isinstance(table, pa.Table)}
    if len(tables) < len(found):
        return (
            UNREAD
            if not tables
            else "; ".join(f"{name}: {what if isinstance(what, str) else 'reads it'}" for name, what in found.items())
        )
    first = found["pyarrow"]
    for name, table in tables.items():
        if table.column_names != first.column_names:
            return f"{name} finds other columns than pyarrow"
        for column in first.column_names:
            if table[column].to_pylist() != first[column].to_pylist():
                return f"{name} reads other values of column {column} than pyarrow"
    return None


def _serve(pipe: Connection) -> None:
    """Compare what is sent until nothing more comes. Silent, because Polars prints when it panics."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    with tempfile.TemporaryDirectory() as folder, suppress(EOFError):
        while True:
            pipe.send(difference(pipe.recv_bytes(), Path(folder, "segment.parquet")))


class Readers:
    """The three readers in a process of their own, which is started again when one of them ends it."""

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self._pipe, theirs = get_context("spawn").Pipe()
        self._process = get_context("spawn").Process(target=_serve, args=(theirs,), daemon=False)
        self._process.start()
        theirs.close()

    def differ(self, data: bytes) -> str | None:
        """Return the `difference`; also when the process ends."""
        try:
            self._pipe.send_bytes(data)
            if not self._pipe.poll(60):
                self._process.kill()
            answer: str | None = self._pipe.recv()
            return answer
        except (EOFError, OSError):
            self._process.join()
            code = self._process.exitcode
            self._start()
            return f"a reader ended the process ({code})"

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join()


def soak(
    first: int, count: int, *, is_loose: bool = False, kinds: tuple[str, ...] = tuple(KINDS)
) -> tuple[Counter[tuple[str, str]], list[str]]:
    """Count how mutations of each kind, from this number on, ended; return the counts and the first few differences."""
    templates, counts, differences = [Template(data) for data in segments()], Counter[tuple[str, str]](), list[str]()
    readers = Readers()
    try:
        for number in range(first, first + count):
            kind = kinds[number % len(kinds)]
            draw = random.Random(number)
            template = draw.choice(templates)
            data = mutated(template, kind, draw)
            if data == template.data:
                continue
            if not is_loose and not is_accepted(data):
                counts[kind, "refused"] += 1
                continue
            found = readers.differ(data)
            counts[kind, {None: "alike", UNREAD: "unread"}.get(found, "different")] += 1
            if found not in (None, UNREAD) and len(differences) < 20:
                differences.append(f"{kind}, number {number}: {found}")
    finally:
        readers.close()
    return counts, differences


def main(arguments: list[str]) -> int:
    """Print the counts for every kind of mutation. Return 1 if readers differ (with --loose: if they do not)."""
    is_loose, began = "--loose" in arguments, time.monotonic()
    numbers = [int(argument) for argument in arguments if argument != "--loose"]
    wanted, firsts = numbers[0] if numbers else 100_000, iter(range(0, 1 << 40, BATCH))
    counts, differences = Counter[tuple[str, str]](), list[str]()
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        while sum(counts.values()) < wanted:  # some mutations change nothing
            batches = [
                pool.submit(soak, next(firsts), min(BATCH, wanted), is_loose=is_loose)
                for _ in range(min(40, -(-wanted // BATCH)))
            ]
            for batch in batches:
                found, more = batch.result()
                counts += found
                differences += more
    print(f"{'mutation':28}{''.join(f'{outcome:>11}' for outcome in OUTCOMES)}")
    for kind in [*KINDS, None]:
        row = [
            sum(count for (name, end), count in counts.items() if end == outcome and kind in (name, None))
            for outcome in OUTCOMES
        ]
        print(f"{kind or 'all':28}{''.join(f'{count:11,}' for count in row)}")
    print(f"{sum(counts.values()):,} mutations in {time.monotonic() - began:.0f} s")
    for text in differences[:20]:
        print(f"  {text}")
    return int(bool(differences) != is_loose)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
