"""What the formats share: JSON arrays written element by element, run time as time of day, and what was written."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import msgspec

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import UsageError


class Written(NamedTuple):
    """The number of events in a file, and what else is to be told about it, a line each."""

    events: int
    notes: tuple[str, ...]


def elements(documents: Iterable[object]) -> Iterator[bytes]:
    """Yield each document as an element of a JSON array, on a line of its own, without the brackets."""
    between = b"\n"
    for one in documents:
        yield between + msgspec.json.encode(one)
        between = b",\n"


LATEST_YEAR = 9000
"""Leaves room for the longest run, of 2^53 microseconds, before the last year that a date can have."""
TOLD = "times count from 1970-01-01T00:00:00Z in runs whose first event names no epoch"


def epoch_us(run: str, epoch: str | None) -> int:
    """Return run time 0 in microseconds since 1970, from the epoch that event 0 of a run names; 0 if it names none.

    Raises: UsageError if that is no time in ISO 8601 between 1970 and `LATEST_YEAR`.
    """
    if epoch is None:
        return 0
    try:
        found = utc.parsed(epoch)
        if not utc.EPOCH <= found <= datetime(LATEST_YEAR, 1, 1, tzinfo=UTC):
            raise ValueError("too early or too late")
    except ValueError as error:
        raise UsageError(
            f"run {printable.value(run)}: found the epoch {printable.value(epoch)}, expected a time in ISO 8601 "
            f"between 1970 and {LATEST_YEAR}; name another run"
        ) from error
    return (found - utc.EPOCH) // utc.MICROSECOND


def rfc3339(time_us: int) -> str:
    """Return a time in UTC from its microseconds since 1970."""
    return utc.shown(utc.EPOCH + timedelta(microseconds=time_us), "microseconds")
