"""Untrusted SQL with its whole answer in memory, and the processes that answer it."""

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from fsar_ledger.api.table import rows_of
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.metrics.sandbox import Limits
from fsar_ledger.metrics.untrusted import stream_untrusted


class Answer(NamedTuple):
    """As `Stream`, with all rows."""

    head: Head
    rows_verified: bool
    columns: list[str]
    rows: list[dict[str, Any]]


def run_untrusted(ledger: Path, sql: str, limits: Limits | None = None, demanded: str | None = None) -> Answer:
    with stream_untrusted(ledger, sql, limits, demanded) as answer:
        rows = [row for batch in answer.batches for part in rows_of(batch) for row in part]
        return Answer(answer.head, answer.rows_verified, answer.columns, rows)


def children() -> set[str]:
    """Return the numbers of the processes that this one has started, where the system lists them."""
    numbers: set[str] = set()
    for listed in Path("/proc/self/task").glob("*/children"):
        with suppress(FileNotFoundError, ProcessLookupError):  # its thread has ended since it was listed
            numbers.update(listed.read_text().split())
    return numbers
